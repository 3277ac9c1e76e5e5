// SPDX-License-Identifier: Apache-2.0
//
// Stand-in of the vendor primitive, for lint and simulation: what its port does, and what a test does to it.
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
    reg stall   = 1'b0;  // a test sets these
    reg prerror = 1'b0;

    wire [7:0] status;
    wire synced, failed, aborting;
    wire [31:0] read;
    cm_config_port #(.FRAME_WORDS(93), .PIPELINE(25)) core (
        .clk(CLK), .csib(CSIB || stall), .rdwrb(RDWRB), .i(I), .status(status),
        .synced(synced), .failed(failed), .aborting(aborting), .prdone(PRDONE), .o(read)
    );
    assign O       = !RDWRB ? 32'd0 : aborting ? {24'd0, status} : read;
    assign AVAIL   = !stall;
    assign PRERROR = failed || prerror;
    wire unused = &{1'b0, synced};
endmodule

`default_nettype wire
