// SPDX-License-Identifier: Apache-2.0
//
// What the configuration port of a device does with the words on its pins, as far as a load can fail in
// it: sync word, packets, CRC, IDCODE, aborts (UG470 and UG570, "Configuration Details", "SelectMAP
// ABORT"). Compared word by word with the vendor's simulation models by tests/rtl/test_config_port.py.
//
// The bits of every byte arrive reversed. Until the sync word everything is ignored; a wrong CRC or IDCODE
// takes the port out of sync at once, and shows until the next sync word. RDWRB may change only while CSIB
// is high: else the port aborts, four clocks long, and must be given a sync word again.
//
// Read back are IDCODE, STAT (UG470, table 5-28) and frames (CMD RCFG, FAR, FDRO): the answer of a clock with CSIB low
// is on O three clocks later, as long as CSIB is low then. Frames pass through a buffer of one frame both ways: the last
// one written stays in it (the pad frame of a bitstream), and the first one read is what was in it. FAR is counted up by
// one after each frame, without the gaps that a device's columns have, and its low FRAME_BITS bits choose the place.
`default_nettype none

module cm_config_port #(
    parameter [31:0] IDCODE = 32'd0, // of the device, its revision is not compared; 0 takes any
    parameter FRAME_WORDS = 101,     // 101: 7 series, 93: UltraScale+; at most 128
    parameter PIPELINE = 0,          // words before the pad frame; 25: UltraScale+ (UG570)
    parameter FRAME_BITS = 10
) (
    input  wire        clk,
    input  wire        csib,
    input  wire        rdwrb,
    input  wire [31:0] i,
    output wire [7:0]  status,  // CFGERR_B, DALIGN, RIP, IN_ABORT_B, 1111 as an abort shows them
    output reg         synced,
    output reg         failed,  // CRC or IDCODE
    output reg         aborting,
    output reg         prdone,  // no frames are being written
    output wire [31:0] o        // what is read; 0 while there is nothing
);
    localparam [31:0] SYNC = 32'hAA995566;
    localparam [4:0] CRC = 5'd0, FAR = 5'd1, FDRI = 5'd2, FDRO = 5'd3, CMD = 5'd4, STAT = 5'd7, ID = 5'd12;
    localparam [31:0] RCRC = 32'd7, DESYNC = 32'd13, RCFG = 32'd4;
    // of a device that runs: EOS, GTS_CFG_B, GWE, GHIGH_B, MMCM_LOCK, DCI_MATCH, INIT_COMPLETE, INIT_B, RELEASE_DONE, DONE
    localparam [31:0] RUNNING = 32'h000078FC;

    reg        csib_before, rdwrb_before;
    reg [1:0]  left;   // clocks of an abort
    reg [3:0]  shown;  // DALIGN in them, the last one first
    reg [4:0]  address;
    reg [26:0] remaining;
    reg [31:0] crc;

    // A function, and not a wire: a simulator works it out where a word is taken, and not at every clock.
    function [31:0] swapped(input [31:0] pins);
        integer n;
        begin
            for (n = 0; n < 32; n = n + 1)
                swapped[n] = pins[(n / 8) * 8 + 7 - n % 8];
        end
    endfunction

    // CRC-32C over 37 bits more, the 32 of the word and 5 of the register's address
    function [31:0] added(input [31:0] sum, input [36:0] bits);
        integer n;
        begin
            added = sum;
            for (n = 0; n < 37; n = n + 1)
                added = (added >> 1) ^ ((added[0] ^ bits[n]) ? 32'h82F63B78 : 32'd0);
        end
    endfunction

    function differs(input [31:0] code);
        differs = IDCODE != 32'd0 && ((code ^ IDCODE) & 32'h0FFFFFFF) != 32'd0;
    endfunction

    // in an abort the port shows that it begins, that it is under way, that it is out of sync, that it is over
    wire aligned = aborting ? shown[left] : synced;
    wire under_way  = aborting && (left == 2'd2 || left == 2'd1);
    assign status = {!failed, aligned, 1'b0, !under_way, 4'b1111};

    initial begin
        csib_before  = 1'b1;
        rdwrb_before = 1'b0;
        synced       = 1'b0;
        failed       = 1'b0;
        aborting     = 1'b0;
        prdone       = 1'b1;
        left         = 2'd0;
        shown        = 4'd0;
        address      = 5'd0;
        remaining    = 27'd0;
        crc          = 32'd0;
    end

    reg [31:0] word;  // that is taken, within this clock

    // the frames, the buffer before them, and the pipeline behind them
    reg [31:0] memory [0:(1<<(FRAME_BITS+7))-1];
    reg [31:0] buffer [0:127];
    reg [31:0] command, far;
    reg [26:0] asked;    // words that are still to be read
    reg [6:0]  column;   // word of the frame under way
    reg [7:0]  skipped;  // words of the pipeline
    reg        first;    // the buffer holds nothing for memory yet
    reg        wrong;    // device
    reg [31:0] answer, answer_1, answer_2;
    wire [FRAME_BITS+6:0] place = {far[FRAME_BITS-1:0], column};
    assign o = csib ? 32'd0 : swapped(answer_2);
    integer k;
    initial begin
        for (k = 0; k < (1 << (FRAME_BITS + 7)); k = k + 1) memory[k] = 32'd0;
        for (k = 0; k < 128; k = k + 1) buffer[k] = 32'd0;
        {command, far, asked, column, skipped, first, wrong} = 0;
        {answer, answer_1, answer_2} = 96'd0;
    end

    task next_column(input moves);  // a frame went to memory, or came from it
        begin
            if (column == FRAME_WORDS[6:0] - 7'd1) begin
                column <= 7'd0;
                first  <= 1'b0;
                if (moves) far <= far + 32'd1;
            end else column <= column + 7'd1;
        end
    endtask

    task start_frames;
        begin
            column  <= 7'd0;
            first   <= 1'b1;
            skipped <= 8'd0;
        end
    endtask

    /* verilator lint_off BLKSEQ */
    always @(posedge clk) begin
        csib_before  <= csib;
        rdwrb_before <= rdwrb;
        if (aborting) begin
            left     <= left - 2'd1;
            aborting <= left != 2'd0;
        end else if (!csib && !csib_before && rdwrb != rdwrb_before) begin
            aborting  <= 1'b1;
            left      <= 2'd3;
            shown     <= {synced, synced, 2'b00};
            synced    <= 1'b0;
            remaining <= 27'd0;
            asked     <= 27'd0;
        end else if (!csib && !rdwrb) begin
            word = swapped(i);
            if (!synced) begin
                if (word == SYNC) begin
                    synced    <= 1'b1;
                    failed    <= 1'b0;
                    wrong     <= 1'b0;
                    remaining <= 27'd0;
                    asked     <= 27'd0;
                end
            end else if (remaining != 27'd0) begin
                remaining <= remaining - 27'd1;
                if (address == CRC) begin
                    crc <= 32'd0;
                    if (word != crc) begin
                        failed <= 1'b1;
                        synced <= 1'b0;
                    end
                end else begin
                    crc <= added(crc, {address, word});
                    if (address == CMD && word == RCRC)
                        crc <= 32'd0;
                    if (address == CMD && word == DESYNC) begin
                        synced <= 1'b0;
                        prdone <= 1'b1;
                    end
                    if (address == CMD)
                        command <= word;
                    if (address == FAR) begin
                        far <= word;
                        start_frames;
                    end
                    if (address == FDRI) begin
                        prdone <= 1'b0;
                        if (!first) memory[place] <= buffer[column];
                        buffer[column] <= word;
                        next_column(!first);
                    end
                    if (address == ID && differs(word)) begin
                        failed <= 1'b1;
                        wrong  <= 1'b1;
                        synced <= 1'b0;
                    end
                end
            end else if (word[31:29] == 3'd1) begin
                if (word[28:27] != 2'd0) address <= word[17:13];
                remaining <= word[28:27] == 2'd2 ? {16'd0, word[10:0]} : 27'd0;
                if (word[28:27] == 2'd1) asked <= {16'd0, word[10:0]};
            end else if (word[31:29] == 3'd2) begin
                remaining <= word[28:27] == 2'd2 ? word[26:0] : 27'd0;  // to the register of the packet before
                if (word[28:27] == 2'd1) asked <= word[26:0];
            end
        end
        answer   <= 32'd0;
        answer_1 <= answer;
        answer_2 <= answer_1;
        if (!csib && rdwrb && !aborting && synced && asked != 27'd0) begin
            asked <= asked - 27'd1;
            if (address == ID)
                answer <= IDCODE;
            else if (address == STAT)
                answer <= RUNNING | {16'd0, wrong, 14'd0, failed && !wrong};
            else if (address == FDRO && command == RCFG) begin
                if ({24'd0, skipped} != PIPELINE)
                    skipped <= skipped + 8'd1;
                else begin
                    answer <= buffer[column];
                    buffer[column] <= memory[place];
                    next_column(1'b1);
                end
            end
        end
    end
endmodule

`default_nettype wire
