// SPDX-License-Identifier: Apache-2.0
//
// Cuts an AXI4-Stream that a region sends off the static part, without breaking the protocol on
// the static side: a beat once offered stays until it is taken, and a packet that was open when
// `decouple` rose is closed by one beat with TLAST and the payload CLOSING, so that a DMA behind
// it ends its transfer (short) instead of gluing two modules' packets together.
//
// From the clock edge at which `decouple` is high nothing of the region is looked at.
// `decoupled` is high when nothing is pending on the static side either.
`default_nettype none

module cm_axis_master_decoupler #(
    parameter PAYLOAD_WIDTH = 32,                  // TDATA and every side-band signal but TLAST
    parameter [PAYLOAD_WIDTH-1:0] CLOSING = 0,     // payload of the closing beat
    parameter HAS_LAST = 1                         // 0: no TLAST, each beat is a packet
) (
    input  wire                     clk,
    input  wire                     resetn,
    input  wire                     decouple,
    output wire                     decoupled,
    // from the region
    input  wire                     s_tvalid,
    output wire                     s_tready,
    input  wire                     s_tlast,
    input  wire [PAYLOAD_WIDTH-1:0] s_tpayload,
    // to the static part
    output reg                      m_tvalid,
    input  wire                     m_tready,
    output reg                      m_tlast,
    output reg  [PAYLOAD_WIDTH-1:0] m_tpayload
);
    reg open;  // a packet has begun whose last beat has not come

    wire room  = !m_tvalid || m_tready;
    wire take  = s_tvalid && s_tready;
    wire close = decouple && open && room;

    assign s_tready  = room && !decouple;
    assign decoupled = decouple && !open && !m_tvalid;

    always @(posedge clk) begin
        if (!resetn) begin
            m_tvalid   <= 1'b0;
            m_tlast    <= 1'b0;
            m_tpayload <= {PAYLOAD_WIDTH{1'b0}};
            open       <= 1'b0;
        end else begin
            if (room) m_tvalid <= take || close;
            if (take) begin
                m_tlast    <= s_tlast;
                m_tpayload <= s_tpayload;
                open       <= (HAS_LAST != 0) && !s_tlast;
            end else if (close) begin
                m_tlast    <= 1'b1;
                m_tpayload <= CLOSING;
                open       <= 1'b0;
            end
        end
    end
endmodule

`default_nettype wire
