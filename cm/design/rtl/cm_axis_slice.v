// SPDX-License-Identifier: Apache-2.0
//
// Two beats of an AXI4-Stream kept: no signal passes from one side to the other within a clock, neither
// TVALID forth nor TREADY back, at a beat per clock. Where modules can be put in a row, and in a ring,
// nothing else keeps their paths from becoming one that feeds itself.
`default_nettype none

module cm_axis_slice #(
    parameter PAYLOAD_WIDTH = 32  // TDATA and every side-band signal, TLAST too
) (
    input  wire                     clk,
    input  wire                     resetn,
    input  wire                     s_tvalid,
    output wire                     s_tready,
    input  wire [PAYLOAD_WIDTH-1:0] s_tpayload,
    output wire                     m_tvalid,
    input  wire                     m_tready,
    output wire [PAYLOAD_WIDTH-1:0] m_tpayload
);
    reg [PAYLOAD_WIDTH-1:0] first, second;
    reg [1:0]               held;  // beats
    reg                     awake; // not in the first clock of a reset's end

    wire take = s_tvalid && s_tready;
    wire give = m_tvalid && m_tready;

    assign s_tready   = awake && held != 2'd2;
    assign m_tvalid   = held != 2'd0;
    assign m_tpayload = first;

    always @(posedge clk) begin
        if (!resetn) begin
            held  <= 2'd0;
            awake <= 1'b0;
        end else begin
            awake <= 1'b1;
            held  <= held + {1'b0, take} - {1'b0, give};
        end
        if (give) first <= second;
        if (take) begin
            if (held == 2'd0 || (held == 2'd1 && give)) first <= s_tpayload;
            else second <= s_tpayload;
        end
    end
endmodule

`default_nettype wire
