// SPDX-License-Identifier: Apache-2.0
//
// A module between anchors, and flip-flops on their other side.
module harness (
    input wire clk
);
    wire g;
    wire [7:0] into, from, out, kept, passed;
    BUFG buffer (.I(clk), .O(g));
    genvar i;
    generate
        for (i = 0; i < 8; i = i + 1) begin : anchors
            (* keep *) FDRE begins (.C(g), .CE(1'b1), .R(1'b0), .D(kept[i]), .Q(kept[i]));
            (* keep *) LUT1 #(.INIT(2'b10)) enters (.I0(kept[i]), .O(into[i]));
            (* keep *) LUT1 #(.INIT(2'b10)) leaves (.I0(from[i]), .O(out[i]));
            (* keep *) LUT1 #(.INIT(2'b10)) passes (.I0(out[i]), .O(passed[i]));
            (* keep *) FDRE ends (.C(g), .CE(1'b1), .R(1'b0), .D(passed[i]), .Q());
        end
    endgenerate
    (* keep *) everything module_inside (.clk(g), .a(into), .y(from));
endmodule
