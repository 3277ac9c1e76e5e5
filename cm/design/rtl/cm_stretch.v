// SPDX-License-Identifier: Apache-2.0
//
// Makes every pulse of `d` at least CYCLES clocks long, so that a slower clock sees it.
`default_nettype none

module cm_stretch #(
    parameter WIDTH = 1,
    parameter CYCLES = 4  // at most 255
) (
    input  wire             clk,
    input  wire             resetn,
    input  wire [WIDTH-1:0] d,
    output wire [WIDTH-1:0] q
);
    genvar i;
    generate
        for (i = 0; i < WIDTH; i = i + 1) begin : line
            reg [7:0] count;
            reg       high;
            assign q[i] = high;
            always @(posedge clk) begin
                if (!resetn) begin
                    count <= 8'd0;
                    high  <= 1'b0;
                end else begin
                    high <= d[i] || count != 8'd0;
                    if (d[i]) count <= CYCLES[7:0];
                    else if (count != 8'd0) count <= count - 8'd1;
                end
            end
        end
    endgenerate
endmodule

`default_nettype wire
