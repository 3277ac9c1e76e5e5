// SPDX-License-Identifier: Apache-2.0
//
// Inverts every pixel's colours. Has no registers: accesses to the region's register
// window are then answered with SLVERR.
`default_nettype none

module pixel_invert (
    input  wire        clk,
    input  wire        resetn,
    input  wire [31:0] s_axis_tdata,
    input  wire        s_axis_tvalid,
    output wire        s_axis_tready,
    input  wire        s_axis_tlast,
    output reg  [31:0] m_axis_tdata,
    output reg         m_axis_tvalid,
    input  wire        m_axis_tready,
    output reg         m_axis_tlast
);
    wire take = s_axis_tvalid && s_axis_tready;
    assign s_axis_tready = !m_axis_tvalid || m_axis_tready;

    always @(posedge clk) begin
        if (!resetn) begin
            m_axis_tvalid <= 1'b0;
            m_axis_tlast  <= 1'b0;
            m_axis_tdata  <= 32'd0;
        end else begin
            if (s_axis_tready) m_axis_tvalid <= take;
            if (take) begin
                m_axis_tdata <= s_axis_tdata ^ 32'h00FFFFFF;
                m_axis_tlast <= s_axis_tlast;
            end
        end
    end
endmodule

`default_nettype wire
