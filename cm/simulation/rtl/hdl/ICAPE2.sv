// SPDX-License-Identifier: Apache-2.0
//
// The configuration port of 7 series in the simulated board: words go to the harness too, which knows whether the port
// shows an error that was injected (UG470: O[7] is CFGERR_B, active low).
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

    reg injected = 1'b0;
    always @(posedge CLK) injected <= cm_configured(I, {31'd0, !CSIB && !RDWRB}) != 0;

    wire [7:0] status;
    wire synced, failed, aborting, prdone;
    wire [31:0] read;
    cm_config_port core (
        .clk(CLK), .csib(CSIB), .rdwrb(RDWRB), .i(I), .status(status),
        .synced(synced), .failed(failed), .aborting(aborting), .prdone(prdone), .o(read)
    );
    // 0xFFFFFF5B was measured of a device that had refused a load
    assign O = RDWRB && !aborting ? read : {24'hFFFFFF, status[7] && !injected, status[6:0]};
    wire unused = &{ICAP_WIDTH != "X32", synced, failed, prdone};
endmodule

`default_nettype wire
