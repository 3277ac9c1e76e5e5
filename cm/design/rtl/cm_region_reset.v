// SPDX-License-Identifier: Apache-2.0
//
// Reset of a region: asserted with the system's, while the region is decoupled or held, and for
// CYCLES clocks after that, so that a module starts from its reset state before it is heard.
`default_nettype none

module cm_region_reset #(
    parameter CYCLES = 16
) (
    input  wire clk,
    input  wire resetn,
    input  wire hold,           // decoupled, or held by software
    output reg  region_resetn,
    output wire busy            // the region is or was just in reset: do not listen yet
);
    reg [7:0] count;

    // until the module is out of its reset, too: one in reset may take a beat that waits, and loses it
    assign busy = hold || count != 8'd0 || !region_resetn;

    always @(posedge clk) begin
        if (!resetn) begin
            count         <= CYCLES;
            region_resetn <= 1'b0;
        end else begin
            region_resetn <= !hold && count == 8'd0;
            if (hold) count <= CYCLES;
            else if (count != 8'd0) count <= count - 8'd1;
        end
    end
endmodule

`default_nettype wire
