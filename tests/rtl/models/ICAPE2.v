// SPDX-License-Identifier: Apache-2.0
//
// Stand-in of the vendor primitive's ports, for lint and simulation only.
`default_nettype none

module ICAPE2 #(
    parameter ICAP_WIDTH = "X32"
) (
    input  wire        CLK,
    input  wire        CSIB,
    input  wire        RDWRB,
    input  wire [31:0] I,
    output wire [31:0] O
);
    reg [31:0] last = 32'd0;
    reg cfgerr_b = 1'b1; // UG470 table 2-7, O[7]: a test sets it
    always @(posedge CLK) if (!CSIB && !RDWRB) last <= I;
    assign O = {24'd0, cfgerr_b, 7'h1F} | (last & 32'd0);
    wire unused = ICAP_WIDTH != "X32";
endmodule

`default_nettype wire
