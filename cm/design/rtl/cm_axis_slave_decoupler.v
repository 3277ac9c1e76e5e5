// SPDX-License-Identifier: Apache-2.0
//
// Cuts an AXI4-Stream that a region receives off the static part. A packet that was half
// through when `decouple` rose is taken and dropped to its end, so that the next module begins
// with a whole packet; after that the sender is held off (TREADY low), nothing is lost.
//
// From the clock edge at which `decouple` is high the region sees TVALID low.
`default_nettype none

module cm_axis_slave_decoupler #(
    parameter PAYLOAD_WIDTH = 32,  // TDATA and every side-band signal but TLAST
    parameter HAS_LAST = 1         // 0: no TLAST, each beat is a packet
) (
    input  wire                     clk,
    input  wire                     resetn,
    input  wire                     decouple,
    output wire                     decoupled,
    // from the static part
    input  wire                     s_tvalid,
    output wire                     s_tready,
    input  wire                     s_tlast,
    input  wire [PAYLOAD_WIDTH-1:0] s_tpayload,
    // to the region
    output wire                     m_tvalid,
    input  wire                     m_tready,
    output wire                     m_tlast,
    output wire [PAYLOAD_WIDTH-1:0] m_tpayload
);
    reg open;  // a packet has begun whose last beat has not come
    reg drop;  // the rest of a packet whose head the former module got

    wire cut  = decouple || drop;
    wire take = s_tvalid && s_tready;

    assign s_tready   = cut ? open : m_tready;
    assign m_tvalid   = s_tvalid && !cut;
    assign m_tlast    = s_tlast && !cut;
    assign m_tpayload = s_tpayload & {PAYLOAD_WIDTH{!cut}};
    assign decoupled  = decouple && !open;

    always @(posedge clk) begin
        if (!resetn) begin
            open <= 1'b0;
            drop <= 1'b0;
        end else begin
            if (take) open <= (HAS_LAST != 0) && !s_tlast;
            // dropping goes on to the packet's end although the region may be back by then
            drop <= open && !(take && s_tlast) && (decouple || drop);
        end
    end
endmodule

`default_nettype wire
