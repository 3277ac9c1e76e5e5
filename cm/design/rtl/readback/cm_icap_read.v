// SPDX-License-Identifier: Apache-2.0
//
// cm_icap.v with a way back: what the port answers leaves as an AXI4-Stream, in the order of bits and bytes of loads.
//
// How many words to read stands in the request itself: it is followed word by word (UG470 and UG570, "Packet Types"),
// and where a stream packet ends after a configuration packet that asks for words, so many are read from the port and
// sent as one stream packet. Between is what a bus needs to turn round: RDWRB changes only while CSIB is high, which
// would abort otherwise, and the port's answer comes LATENCY clocks after CSIB (UG570, "Configuration Memory Read
// Procedure": three). The port cannot be held meanwhile: a CSIB that rises loses the words that are on their way. So
// they go through a FIFO, and where a reader is too slow for it, the packet ends early (TLAST with fewer words).
//
// A word that comes on s while an answer is not taken yet says that nobody waits for the rest: it is dropped. The port
// is always read to the end of its packet, so that it never stands in the middle of one.
`default_nettype none

module cm_icap_read #(
    parameter ULTRASCALE = 0,  // 0: ICAPE2 (7 series), 1: ICAPE3 (UltraScale, UltraScale+)
    parameter DEPTH_BITS = 10  // words of the FIFO: 1 << DEPTH_BITS
) (
    input  wire        clk,
    input  wire        resetn,
    input  wire        s_tvalid,
    output wire        s_tready,
    input  wire [31:0] s_tdata,
    input  wire        s_tlast,
    output reg         m_tvalid,
    input  wire        m_tready,
    output reg  [31:0] m_tdata,
    output reg         m_tlast,
    output wire [2:0]  status,  // [0] the last packet ended, [1] error, [2] a load is under way
    output reg  [31:0] words    // of the running or last packet
);
    localparam [27:0] LATENCY = 28'd3;
    localparam [31:0] SYNC = 32'hAA995566, DESYNC = 32'h0000000D;
    localparam [4:0] FDRI = 5'd2, CMD = 5'd4;
    localparam [1:0] NOP = 2'd0, READ = 2'd1, WRITE = 2'd2;
    localparam [2:0] IN = 3'd0, ENDED = 3'd1, TURN = 3'd2, OUT = 3'd3, REST = 3'd4, BACK = 3'd5;

    reg [2:0]  state = IN;
    reg        rdwrb = 1'b0;
    reg [31:0] word;
    reg        pending, last, done, fresh;
    wire       available, failed;
    wire [31:0] out;

    function [31:0] swap(input [31:0] x);
        integer n;
        begin
            for (n = 0; n < 32; n = n + 1)
                swap[n] = x[(n / 8) * 8 + 7 - n % 8];
        end
    endfunction

    // words to the port: as in cm_icap.v, but that none is taken until it is known what the packet's end means
    wire writes = state == IN && pending && available;
    wire csib   = !(writes || state == OUT);
    assign s_tready = state == IN && (!pending || (available && !last));

    // what they say
    reg        synced, frames;
    reg [4:0]  register;
    reg [26:0] payload, wanted;
    wire [31:0] plain = swap(word);
    wire [1:0]  operation = plain[28:27];
    wire [26:0] count = plain[29] ? {16'd0, plain[10:0]} : plain[26:0];
    wire        header = synced && payload == 27'd0 && (plain[31:29] == 3'd1 || plain[31:29] == 3'd2);

    always @(posedge clk) begin
        if (!resetn) begin
            synced   <= 1'b0;
            frames   <= 1'b0;
            register <= 5'd0;
            payload  <= 27'd0;
            wanted   <= 27'd0;
        end else if (writes) begin
            if (!synced) begin
                synced  <= plain == SYNC;
                payload <= 27'd0;
                wanted  <= 27'd0;
            end else if (payload != 27'd0) begin
                payload <= payload - 27'd1;
                if (register == CMD && plain == DESYNC) synced <= 1'b0;
            end else if (header && operation != NOP) begin
                if (plain[29]) register <= plain[17:13];
                payload <= operation == WRITE ? count : 27'd0;
                wanted  <= operation == READ ? count : 27'd0;
            end
            // a load is one that writes frames, or is longer than any request
            if (header && operation == WRITE && plain[29] && plain[17:13] == FDRI) frames <= 1'b1;
            if (words[31:8] != 24'd0 && wanted == 27'd0) frames <= 1'b1;
            if (last) frames <= 1'b0;
        end else if (state == BACK) wanted <= 27'd0;
    end

    // the bus, to and fro
    reg [27:0] clocks;  // that the port has been read for
    wire       all     = clocks == {1'b0, wanted} + LATENCY - 28'd1;
    wire       reading = state == OUT || state == REST;
    wire       empty, dropped;

    always @(posedge clk) begin
        if (!resetn) begin  // also in a reset CSIB rises before RDWRB changes
            state  <= state == OUT ? REST : IN;
            rdwrb  <= state == OUT;
            clocks <= 28'd0;
        end else case (state)
            IN: if (writes && last) state <= ENDED;
            ENDED: begin
                state  <= synced && wanted != 27'd0 ? TURN : IN;
                rdwrb  <= synced && wanted != 27'd0;
                clocks <= 28'd0;
            end
            TURN: if (available) state <= OUT;
            OUT: begin
                clocks <= clocks + 28'd1;
                if (all) state <= REST;
            end
            REST: if (empty || dropped) begin
                rdwrb <= 1'b0;
                state <= BACK;
            end
            default: state <= IN;
        endcase
    end

    always @(posedge clk) begin
        if (!resetn) begin
            pending <= 1'b0;
            last    <= 1'b0;
            word    <= 32'd0;
            words   <= 32'd0;
            done    <= 1'b0;
            fresh   <= 1'b1;
        end else begin
            if (writes) pending <= 1'b0;
            if (state == ENDED) done <= !(synced && wanted != 27'd0);
            if (s_tvalid && s_tready) begin
                pending <= 1'b1;
                word    <= swap(s_tdata);
                last    <= s_tlast;
                words   <= fresh ? 32'd1 : words + 32'd1;
                fresh   <= s_tlast;
                if (fresh) done <= 1'b0;
            end
        end
    end

    assign status = {frames, failed, done};

    // the answer: a word is kept back until it is known whether it is the last
    reg  [31:0] held;
    reg         holds, over;  // over: nothing more is kept
    reg  [32:0] memory [0:(1<<DEPTH_BITS)-1];
    reg  [DEPTH_BITS:0] written, read;
    reg         abandoned;
    wire        full  = written - read == {1'b1, {DEPTH_BITS{1'b0}}};
    wire        comes = state == OUT && clocks >= LATENCY;
    wire        takes = comes && available && !over && !(holds && full);
    wire        ends  = holds && !full && (over || state == REST);
    wire        push  = holds && !full && (takes || ends);

    assign dropped = reading && (abandoned || s_tvalid);
    assign empty   = !holds && written == read && !m_tvalid;

    always @(posedge clk) begin
        if (push) memory[written[DEPTH_BITS-1:0]] <= {ends, held};
        if (!m_tvalid || m_tready) {m_tlast, m_tdata} <= memory[read[DEPTH_BITS-1:0]];
    end

    always @(posedge clk) begin
        if (!resetn || dropped || !reading) begin
            held      <= 32'd0;
            holds     <= 1'b0;
            over      <= resetn && dropped;
            written   <= {DEPTH_BITS+1{1'b0}};
            read      <= {DEPTH_BITS+1{1'b0}};
            m_tvalid  <= 1'b0;
            abandoned <= resetn && dropped;
        end else begin
            if (takes) held <= swap(out);
            holds <= takes || (holds && !push);
            if (comes && !takes) over <= 1'b1;
            if (push) written <= written + 1'b1;
            if (!m_tvalid || m_tready) begin
                m_tvalid <= written != read;
                if (written != read) read <= read + 1'b1;
            end
        end
    end

    generate
        if (ULTRASCALE != 0) begin : ultrascale
            wire unused_done;
            ICAPE3 port (
                .CLK(clk), .CSIB(csib), .RDWRB(rdwrb), .I(word), .O(out),
                .AVAIL(available), .PRDONE(unused_done), .PRERROR(failed)
            );
            wire unused = &{1'b0, unused_done};
        end else begin : series7
            ICAPE2 #(.ICAP_WIDTH("X32")) port (.CLK(clk), .CSIB(csib), .RDWRB(rdwrb), .I(word), .O(out));
            assign available = 1'b1;
            // as in cm_icap.v
            assign failed = done && !out[7] && out[3] && out[1] && out[0];
        end
    endgenerate
endmodule

`default_nettype wire
