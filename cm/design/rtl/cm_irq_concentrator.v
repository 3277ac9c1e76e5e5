// SPDX-License-Identifier: Apache-2.0
//
// COUNT interrupt lines to one level: a line's rising edge (EDGE bit 1) or level (0) is kept in
// `status` until it is cleared by writing 1; `enable` masks what reaches `irq`. Lines are
// synchronised, and those of a decoupled region are to be held low by the caller.
`default_nettype none

module cm_irq_concentrator #(
    parameter COUNT = 1,
    parameter [COUNT-1:0] EDGE = 0
) (
    input  wire             clk,
    input  wire             resetn,
    input  wire [COUNT-1:0] lines,
    input  wire [COUNT-1:0] enable,
    input  wire [COUNT-1:0] clear,
    output wire [COUNT-1:0] raw,
    output reg  [COUNT-1:0] status,
    output wire             irq
);
    reg [COUNT-1:0] previous;

    cm_sync #(.WIDTH(COUNT)) sync (.clk(clk), .d(lines), .q(raw));

    assign irq = |(status & enable);

    always @(posedge clk) begin
        if (!resetn) begin
            previous <= {COUNT{1'b0}};
            status <= {COUNT{1'b0}};
        end else begin
            previous <= raw;
            // an event in the very clock of its clearing is kept
            status <= (status & ~clear) | (raw & ~(EDGE & previous));
        end
    end
endmodule

`default_nettype wire
