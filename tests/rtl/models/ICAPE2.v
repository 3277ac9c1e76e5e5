// SPDX-License-Identifier: Apache-2.0
//
// Stand-in of the vendor primitive, for lint and simulation: what its port does, and what a test does to it.
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
    reg cfgerr_b = 1'b1;  // O[7]: a test sets it

    wire [7:0] status;
    wire synced, failed, aborting, prdone;
    wire [31:0] read;
    cm_config_port core (
        .clk(CLK), .csib(CSIB), .rdwrb(RDWRB), .i(I), .status(status),
        .synced(synced), .failed(failed), .aborting(aborting), .prdone(prdone), .o(read)
    );
    // 0xFFFFFF5B was measured of a device that had refused a load
    assign O = RDWRB && !aborting ? read : {24'hFFFFFF, status[7] && cfgerr_b, status[6:0]};
    wire unused = &{ICAP_WIDTH != "X32", synced, failed, prdone};
endmodule

`default_nettype wire
