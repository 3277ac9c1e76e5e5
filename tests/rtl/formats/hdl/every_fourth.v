// SPDX-License-Identifier: Apache-2.0
// One sample of four, without TLAST, as beside a converter whose samples come without end.
`default_nettype none

module every_fourth (
    input  wire        clk,
    input  wire        resetn,
    input  wire [11:0] s_axis_tdata,
    input  wire        s_axis_tvalid,
    output wire        s_axis_tready,
    output reg  [11:0] m_axis_tdata,
    output reg         m_axis_tvalid,
    input  wire        m_axis_tready
);
    reg [1:0] phase;

    assign s_axis_tready = !m_axis_tvalid || m_axis_tready;

    always @(posedge clk)
        if (!resetn) begin
            phase <= 2'd0;
            m_axis_tvalid <= 1'b0;
        end else if (s_axis_tready) begin
            m_axis_tdata <= s_axis_tdata;
            m_axis_tvalid <= s_axis_tvalid && phase == 2'd0;
            phase <= phase + s_axis_tvalid;
        end
endmodule

`default_nettype wire
