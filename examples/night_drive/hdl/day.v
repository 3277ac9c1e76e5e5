// SPDX-License-Identifier: Apache-2.0
// Pixels as they are, a byte a beat.
`default_nettype none

module day (
    input  wire       clk,
    input  wire       resetn,
    input  wire [7:0] s_axis_tdata,
    input  wire       s_axis_tvalid,
    output wire       s_axis_tready,
    input  wire       s_axis_tlast,
    output wire [7:0] m_axis_tdata,
    output wire       m_axis_tvalid,
    input  wire       m_axis_tready,
    output wire       m_axis_tlast
);
    assign m_axis_tdata  = s_axis_tdata;
    assign m_axis_tvalid = s_axis_tvalid && resetn;
    assign m_axis_tlast  = s_axis_tlast;
    assign s_axis_tready = m_axis_tready && resetn;
    wire unused = clk;
endmodule

`default_nettype wire
