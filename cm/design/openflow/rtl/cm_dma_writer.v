// SPDX-License-Identifier: Apache-2.0
//
// Stream to memory: a packet into a buffer, in bursts of at most 16 words, none across 128 bytes. A burst begins
// when all its data is there, so it never waits for the stream. TKEEP counts in the last beat; before it a beat is
// whole. `left` says how many bytes of the buffer were not filled. A packet with more bytes than the buffer fills
// it, and ends with `internal_error`; what follows the first beat with too much stays in the stream.
// `stop` ends a transfer: bursts that have begun are ended with their data, the rest is dropped, `quiet` is high.
`default_nettype none

module cm_dma_writer #(
    parameter LENGTH_BITS = 23,
    parameter DATA_BYTES = 8,    // of memory: 4 or 8
    parameter STREAM_BYTES = 1,  // 1, 2, 4 or 8, not more than DATA_BYTES
    parameter HAS_LAST = 1       // 0: no TLAST, a transfer ends when the buffer is full
) (
    input  wire                      clk,
    input  wire                      resetn,
    input  wire                      start,
    input  wire [              31:0] address,   // a multiple of STREAM_BYTES
    input  wire [   LENGTH_BITS-1:0] length,    // bytes, not 0
    input  wire                      stop,
    output wire                      quiet,
    output wire                      done,
    output reg  [   LENGTH_BITS-1:0] left,
    output wire                      internal_error,
    output reg                       slave_error,
    output reg                       decode_error,
    output reg  [              31:0] m_axi_awaddr,
    output reg  [               3:0] m_axi_awlen,
    output reg                       m_axi_awvalid,
    input  wire                      m_axi_awready,
    output wire [8*DATA_BYTES-1:0]   m_axi_wdata,
    output wire [  DATA_BYTES-1:0]   m_axi_wstrb,
    output wire                      m_axi_wlast,
    output wire                      m_axi_wvalid,
    input  wire                      m_axi_wready,
    input  wire [               1:0] m_axi_bresp,
    input  wire                      m_axi_bvalid,
    output wire                      m_axi_bready,
    input  wire [8*STREAM_BYTES-1:0] s_axis_tdata,
    input  wire [  STREAM_BYTES-1:0] s_axis_tkeep,
    input  wire                      s_axis_tlast,
    input  wire                      s_axis_tvalid,
    output wire                      s_axis_tready
);
    localparam SHIFT = DATA_BYTES == 8 ? 3 : 2;
    localparam BEATS = DATA_BYTES / STREAM_BYTES;
    localparam LANE_BITS = BEATS > 1 ? $clog2(BEATS) : 1;
    localparam STEP = STREAM_BYTES > 1 ? $clog2(STREAM_BYTES) : 0;
    localparam [LENGTH_BITS-1:0] STREAM = STREAM_BYTES[LENGTH_BITS-1:0];

    reg busy, receiving, ended, over;
    wire fail = m_axi_bvalid && m_axi_bresp[1];
    wire leave = stop || fail;

    // Beats → words. At most two words are on their way when `count` says that there is room.
    wire [5:0] count;
    reg [8*DATA_BYTES-1:0] data;
    reg [DATA_BYTES-1:0] strobes;
    reg [LANE_BITS-1:0] lane;
    reg fresh;                       // nothing is in the word yet
    reg push;
    wire take = s_axis_tvalid && s_axis_tready;
    wire last = HAS_LAST != 0 && s_axis_tlast;
    wire full = left <= STREAM;
    wire [STREAM_BYTES-1:0] keep = last ? s_axis_tkeep : {STREAM_BYTES{1'b1}};
    wire [STREAM_BYTES-1:0] fits;    // bytes for which there is room
    wire much = |(keep & ~fits);
    wire ends = last || much || (HAS_LAST == 0 && full);
    wire whole = BEATS == 1 || &lane || ends;
    wire some = |(keep & fits) || (!fresh && |strobes);
    reg [3:0] bytes;                 // of this beat, that fit
    integer n;

    assign s_axis_tready = receiving && count < 6'd30;

    always @* begin
        bytes = 4'd0;
        for (n = 0; n < STREAM_BYTES; n = n + 1) if (keep[n] && fits[n]) bytes = n[3:0] + 4'd1;
    end

    genvar at;
    generate
        for (at = 0; at < STREAM_BYTES; at = at + 1) begin : room
            localparam [LENGTH_BITS-1:0] NUMBER = at;
            assign fits[at] = left > NUMBER;
        end
        for (at = 0; at < BEATS; at = at + 1) begin : lanes
            localparam [LANE_BITS-1:0] NUMBER = at;
            wire mine = BEATS == 1 || lane == NUMBER;
            always @(posedge clk)
                if (!resetn) data[8*STREAM_BYTES*at+:8*STREAM_BYTES] <= {8 * STREAM_BYTES{1'b0}};
                else if (take) begin
                    if (mine) begin
                        data[8*STREAM_BYTES*at+:8*STREAM_BYTES] <= s_axis_tdata;
                        strobes[STREAM_BYTES*at+:STREAM_BYTES]  <= keep & fits;
                    end else if (fresh) strobes[STREAM_BYTES*at+:STREAM_BYTES] <= {STREAM_BYTES{1'b0}};
                end
        end
    endgenerate

    always @(posedge clk) begin
        push <= take && whole && some && !leave;
        if (take) begin
            left  <= left - {{(LENGTH_BITS - 4) {1'b0}}, bytes};
            lane  <= lane + 1'b1;
            fresh <= whole;
        end
        if (start) begin
            left  <= length;
            lane  <= address[STEP+:LANE_BITS];
            fresh <= 1'b1;
        end
        if (!resetn || leave) begin
            busy      <= 1'b0;
            receiving <= 1'b0;
            ended     <= 1'b0;
            over      <= 1'b0;
            push      <= 1'b0;
        end else begin
            if (take && ends) begin
                receiving <= 1'b0;
                ended     <= 1'b1;
                over      <= much;
            end
            if (finished) begin
                busy  <= 1'b0;
                ended <= 1'b0;
            end
            if (start) begin
                busy      <= 1'b1;
                receiving <= 1'b1;
                over      <= 1'b0;
            end
        end
    end

    // Words → bursts.
    reg sending;                     // a burst's data
    reg [3:0] beats;                 // of it, behind the one at the output
    reg [2:0] bursts;                // without an answer
    reg [31-SHIFT:0] word;           // where the next one goes
    wire [5:0] to_boundary = 6'd16 - {2'b00, word[3:0]};
    wire enough = count >= to_boundary;
    wire rest = ended && !push && count != 6'd0;
    wire free = !sending && !m_axi_awvalid;
    wire begins = busy && !leave && free && bursts != 3'd7 && (enough || rest);
    wire [5:0] burst = enough ? to_boundary : count;
    wire sent = sending && m_axi_wready;
    wire finished = ended && !push && count == 6'd0 && free && bursts == 3'd0;

    assign m_axi_bready   = 1'b1;
    assign m_axi_wvalid   = sending;
    assign m_axi_wlast    = beats == 4'd0;
    assign quiet          = !busy && free && bursts == 3'd0;
    assign done           = finished && !over && !leave;
    assign internal_error = finished && over && !leave;

    always @(posedge clk) begin
        if (!resetn) begin
            m_axi_awvalid <= 1'b0;
            sending       <= 1'b0;
            bursts        <= 3'd0;
            slave_error   <= 1'b0;
            decode_error  <= 1'b0;
        end else begin
            slave_error  <= fail && m_axi_bresp == 2'b10;
            decode_error <= fail && m_axi_bresp == 2'b11;
            if (m_axi_awready) m_axi_awvalid <= 1'b0;
            if (sent) begin
                beats <= beats - 4'd1;
                if (m_axi_wlast) sending <= 1'b0;
            end
            bursts <= bursts + {2'b00, begins} - {2'b00, m_axi_bvalid};
            if (begins) begin
                m_axi_awvalid <= 1'b1;
                m_axi_awaddr  <= {word, {SHIFT{1'b0}}};
                m_axi_awlen   <= burst[3:0] - 4'd1;
                sending       <= 1'b1;
                beats         <= burst[3:0] - 4'd1;
                word          <= word + {{(26 - SHIFT) {1'b0}}, burst};
            end
        end
        if (start) word <= address[31:SHIFT];
    end

    cm_dma_fifo #(
        .WIDTH(9 * DATA_BYTES)
    ) fifo (
        .clk(clk),
        .clear(!resetn || (!busy && !sending)),
        .push(push),
        .in({strobes, data}),
        .pop(sent),
        .out({m_axi_wstrb, m_axi_wdata}),
        .count(count)
    );

    wire unused = &{1'b0, address};
endmodule

`default_nettype wire
