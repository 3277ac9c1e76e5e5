// SPDX-License-Identifier: Apache-2.0
//
// Stand-in of the vendor primitive's ports, for lint and simulation only.
`default_nettype none

module ICAPE3 (
    input  wire        CLK,
    input  wire        CSIB,
    input  wire        RDWRB,
    input  wire [31:0] I,
    output reg  [31:0] O,
    output wire        AVAIL,
    output wire        PRDONE,
    output wire        PRERROR
);
    always @(posedge CLK) if (!CSIB && !RDWRB) O <= I;
    assign AVAIL   = 1'b1;
    assign PRDONE  = 1'b0;
    assign PRERROR = 1'b0;
endmodule

`default_nettype wire
