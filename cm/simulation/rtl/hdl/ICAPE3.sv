// SPDX-License-Identifier: Apache-2.0
//
// The configuration port of UltraScale+ in the simulated board: words go to the harness too, which knows whether the port
// shows an error that was injected (UG570: PRERROR).
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

    reg injected = 1'b0;
    always @(posedge CLK) injected <= cm_configured(I, {31'd0, !CSIB && !RDWRB}) != 0;

    wire [7:0] status;
    wire synced, failed, aborting;
    wire [31:0] read;
    cm_config_port #(.FRAME_WORDS(93), .PIPELINE(25)) core (
        .clk(CLK), .csib(CSIB), .rdwrb(RDWRB), .i(I), .status(status),
        .synced(synced), .failed(failed), .aborting(aborting), .prdone(PRDONE), .o(read)
    );
    assign O       = !RDWRB ? 32'd0 : aborting ? {24'd0, status} : read;
    assign AVAIL   = 1'b1;
    assign PRERROR = failed || injected;
    wire unused = &{1'b0, synced};
endmodule

`default_nettype wire
