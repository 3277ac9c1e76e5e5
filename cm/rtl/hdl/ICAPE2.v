// SPDX-License-Identifier: Apache-2.0
//
// The configuration port of 7 series in the simulated board: words go to the engine, which knows whether
// the port shows an error (UG470 table 2-7: O[7] is CFGERR_B, active low).
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
    import "DPI-C" function int cm_configured(input int word, input int taken);

    reg failed = 1'b0;
    always @(posedge CLK) failed <= cm_configured(I, {31'd0, !CSIB && !RDWRB}) != 0;
    assign O = {24'd0, !failed, 7'h1F};
    wire unused = ICAP_WIDTH != "X32";
endmodule

`default_nettype wire
