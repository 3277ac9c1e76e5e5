// SPDX-License-Identifier: Apache-2.0
//
// Words of the DMA engine on their way between memory and stream: 32 of them, in distributed RAM. The first
// word is at the output while `count` is not 0; who pushes and pops looks at `count` first.
`default_nettype none

module cm_dma_fifo #(
    parameter WIDTH = 64
) (
    input  wire             clk,
    input  wire             clear,
    input  wire             push,
    input  wire [WIDTH-1:0] in,
    input  wire             pop,
    output wire [WIDTH-1:0] out,
    output reg  [      5:0] count
);
    reg [WIDTH-1:0] words[0:31];
    reg [4:0] first, next;

    assign out = words[first];

    always @(posedge clk) if (push) words[next] <= in;

    always @(posedge clk)
        if (clear) begin
            first <= 5'd0;
            next  <= 5'd0;
            count <= 6'd0;
        end else begin
            if (push) next <= next + 5'd1;
            if (pop) first <= first + 5'd1;
            if (push && !pop) count <= count + 6'd1;
            if (pop && !push) count <= count - 6'd1;
        end
endmodule

`default_nettype wire
