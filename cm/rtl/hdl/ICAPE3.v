// SPDX-License-Identifier: Apache-2.0
//
// The configuration port of UltraScale+ in the simulated board: words go to the engine, which knows whether
// the port shows an error (UG570: PRERROR).
`default_nettype none

module ICAPE3 (
    input  wire        CLK,
    input  wire        CSIB,
    input  wire        RDWRB,
    input  wire [31:0] I,
    output wire [31:0] O,
    output wire        AVAIL,
    output wire        PRDONE,
    output wire        PRERROR
);
    import "DPI-C" function int cm_configured(input int word, input int taken);

    reg failed = 1'b0;
    always @(posedge CLK) failed <= cm_configured(I, {31'd0, !CSIB && !RDWRB}) != 0;
    assign O       = 32'd0;
    assign AVAIL   = 1'b1;
    assign PRDONE  = 1'b0;
    assign PRERROR = failed;
endmodule

`default_nettype wire
