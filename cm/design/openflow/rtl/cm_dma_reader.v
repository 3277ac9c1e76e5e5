// SPDX-License-Identifier: Apache-2.0
//
// Memory to stream: bursts of at most 16 words, none across 128 bytes (so none across 4 KiB), as AXI3 and AXI4
// have them; the bytes of a transfer as one packet. A burst is asked for when there is room for all of it, so data
// is always taken at once. `stop` ends a transfer: what was asked for is taken and dropped, then `quiet` is high.
`default_nettype none

module cm_dma_reader #(
    parameter LENGTH_BITS = 23,
    parameter DATA_BYTES = 8,    // of memory: 4 or 8
    parameter STREAM_BYTES = 1   // 1, 2, 4 or 8, not more than DATA_BYTES
) (
    input  wire                      clk,
    input  wire                      resetn,
    input  wire                      start,
    input  wire [              31:0] address,   // a multiple of STREAM_BYTES
    input  wire [   LENGTH_BITS-1:0] length,    // bytes, not 0
    input  wire                      stop,
    output wire                      quiet,
    output wire                      done,
    output reg                       slave_error,
    output reg                       decode_error,
    output reg  [              31:0] m_axi_araddr,
    output reg  [               3:0] m_axi_arlen,
    output reg                       m_axi_arvalid,
    input  wire                      m_axi_arready,
    input  wire [8*DATA_BYTES-1:0]   m_axi_rdata,
    input  wire [               1:0] m_axi_rresp,
    input  wire                      m_axi_rlast,
    input  wire                      m_axi_rvalid,
    output wire                      m_axi_rready,
    output reg  [8*STREAM_BYTES-1:0] m_axis_tdata,
    output reg  [  STREAM_BYTES-1:0] m_axis_tkeep,
    output reg                       m_axis_tlast,
    output reg                       m_axis_tvalid,
    input  wire                      m_axis_tready
);
    localparam SHIFT = DATA_BYTES == 8 ? 3 : 2;
    localparam BEATS = DATA_BYTES / STREAM_BYTES;
    localparam LANE_BITS = BEATS > 1 ? $clog2(BEATS) : 1;
    localparam STEP = STREAM_BYTES > 1 ? $clog2(STREAM_BYTES) : 0;
    localparam WORD_BITS = LENGTH_BITS + 1 - SHIFT;
    localparam [LENGTH_BITS-1:0] STREAM = STREAM_BYTES[LENGTH_BITS-1:0];
    localparam [LENGTH_BITS:0] ROUND = {{(LENGTH_BITS + 1 - SHIFT) {1'b0}}, {SHIFT{1'b1}}};

    reg busy;                       // from `start` until the last beat is taken
    reg [31-SHIFT:0] word;          // the next to ask for
    reg [WORD_BITS-1:0] words;      // left to ask for
    reg [1:0] bursts;               // asked for, not yet ended
    reg [5:0] promised;             // room for what was asked for and has not come
    reg asking;                     // `burst` holds
    reg [4:0] burst;

    wire [5:0] count;
    wire [8*DATA_BYTES-1:0] head;
    wire pop;
    wire take = m_axi_rvalid && m_axi_rready;
    wire fail = take && m_axi_rresp[1];
    wire leave = stop || fail;

    assign m_axi_rready = 1'b1;
    assign quiet = !busy && !m_axi_arvalid && bursts == 2'd0;

    // Requests: the size of a burst is worked out in one clock, room is waited for in the next.
    wire [4:0] to_boundary = 5'd16 - {1'b0, word[3:0]};
    wire [4:0] next_burst = words < {{(WORD_BITS - 5) {1'b0}}, to_boundary} ? words[4:0] : to_boundary;
    wire room = {1'b0, count} + {1'b0, promised} + {2'b0, burst} <= 7'd32;
    wire ask = asking && room && !m_axi_arvalid && bursts != 2'd3 && !leave;
    wire ended = take && m_axi_rlast;
    wire [LENGTH_BITS:0] span = {1'b0, length} + {{(LENGTH_BITS + 1 - SHIFT) {1'b0}}, address[SHIFT-1:0]}
                              + ROUND;

    always @(posedge clk) begin
        if (!resetn) begin
            m_axi_arvalid <= 1'b0;
            bursts        <= 2'd0;
            promised      <= 6'd0;
            words         <= {WORD_BITS{1'b0}};
            asking        <= 1'b0;
            slave_error   <= 1'b0;
            decode_error  <= 1'b0;
        end else begin
            slave_error  <= fail && m_axi_rresp == 2'b10;
            decode_error <= fail && m_axi_rresp == 2'b11;
            if (m_axi_arready) m_axi_arvalid <= 1'b0;
            bursts   <= bursts + {1'b0, ask} - {1'b0, ended};
            promised <= promised + (ask ? {1'b0, burst} : 6'd0) - {5'd0, take};
            asking   <= !leave && (asking ? !ask : words != {WORD_BITS{1'b0}});
            if (!asking) burst <= next_burst;
            if (ask) begin
                m_axi_arvalid <= 1'b1;
                m_axi_araddr  <= {word, {SHIFT{1'b0}}};
                m_axi_arlen   <= burst[3:0] - 4'd1;
                word          <= word + {{(27 - SHIFT) {1'b0}}, burst};
                words         <= words - {{(WORD_BITS - 5) {1'b0}}, burst};
            end
            if (leave) words <= {WORD_BITS{1'b0}};
            else if (start) begin
                word  <= address[31:SHIFT];
                words <= span[LENGTH_BITS:SHIFT];
            end
        end
    end

    cm_dma_fifo #(
        .WIDTH(8 * DATA_BYTES)
    ) fifo (
        .clk(clk),
        .clear(!resetn || !busy || leave),
        .push(take),
        .in(m_axi_rdata),
        .pop(pop),
        .out(head),
        .count(count)
    );

    // The stream: a beat goes to the output where that is free.
    reg [LENGTH_BITS-1:0] left;      // bytes that are not at the output yet
    reg [LANE_BITS-1:0] lane;        // beat of the word
    wire free = !m_axis_tvalid || m_axis_tready;
    wire last = left <= STREAM;
    wire load = free && count != 6'd0 && left != {LENGTH_BITS{1'b0}};
    wire [STREAM_BYTES-1:0] keep;
    wire [8*STREAM_BYTES-1:0] beat;

    assign pop  = load && (last || BEATS == 1 || &lane);
    assign done = busy && m_axis_tvalid && m_axis_tready && m_axis_tlast && !leave;

    genvar at;
    generate
        for (at = 0; at < STREAM_BYTES; at = at + 1) begin : mark
            localparam [LENGTH_BITS-1:0] NUMBER = at;
            assign keep[at] = left > NUMBER;
        end
        if (BEATS > 1) assign beat = head[8*STREAM_BYTES*lane+:8*STREAM_BYTES];
        else assign beat = head;
    endgenerate

    always @(posedge clk) begin
        if (!resetn || leave) begin
            busy          <= 1'b0;
            m_axis_tvalid <= 1'b0;
            left          <= {LENGTH_BITS{1'b0}};
        end else begin
            if (free) m_axis_tvalid <= load;
            if (load) begin
                m_axis_tdata <= beat;
                m_axis_tkeep <= keep;
                m_axis_tlast <= last;
                left         <= last ? {LENGTH_BITS{1'b0}} : left - STREAM;
                lane         <= lane + 1'b1;
            end
            if (done) busy <= 1'b0;
            if (start) begin
                busy <= 1'b1;
                left <= length;
                lane <= address[STEP+:LANE_BITS];
            end
        end
    end

    wire unused = &{1'b0, address, span};
endmodule

`default_nettype wire
