// SPDX-License-Identifier: Apache-2.0
// Passes beats on with some of their bits turned: TKEEP, TLAST and TUSER stay with them.
module turn #(parameter WIDTH = 8, parameter [WIDTH-1:0] MASK = {WIDTH{1'b1}}) (
    input  wire               clk,
    input  wire               rst_n,
    input  wire [WIDTH-1:0]   s_axis_tdata,
    input  wire [WIDTH/8-1:0] s_axis_tkeep,
    input  wire               s_axis_tuser,
    input  wire               s_axis_tlast,
    input  wire               s_axis_tvalid,
    output wire               s_axis_tready,
    output reg  [WIDTH-1:0]   m_axis_tdata,
    output reg  [WIDTH/8-1:0] m_axis_tkeep,
    output reg                m_axis_tuser,
    output reg                m_axis_tlast,
    output reg                m_axis_tvalid,
    input  wire               m_axis_tready
);
    assign s_axis_tready = !m_axis_tvalid || m_axis_tready;
    always @(posedge clk)
        if (!rst_n)
            m_axis_tvalid <= 1'b0;
        else if (s_axis_tready) begin
            m_axis_tvalid <= s_axis_tvalid;
            m_axis_tdata <= s_axis_tdata ^ MASK;
            m_axis_tkeep <= s_axis_tkeep;
            m_axis_tuser <= s_axis_tuser;
            m_axis_tlast <= s_axis_tlast;
        end
endmodule
