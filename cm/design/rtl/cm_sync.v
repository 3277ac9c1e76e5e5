// SPDX-License-Identifier: Apache-2.0
//
// Level synchroniser of WIDTH independent bits into `clk`; two registers that stay together.
`default_nettype none

module cm_sync #(
    parameter WIDTH = 1
) (
    input  wire             clk,
    input  wire [WIDTH-1:0] d,
    output wire [WIDTH-1:0] q
);
    (* ASYNC_REG = "TRUE" *) reg [WIDTH-1:0] first = {WIDTH{1'b0}};
    (* ASYNC_REG = "TRUE" *) reg [WIDTH-1:0] second = {WIDTH{1'b0}};

    assign q = second;

    always @(posedge clk) begin
        first  <= d;
        second <= first;
    end
endmodule

`default_nettype wire
