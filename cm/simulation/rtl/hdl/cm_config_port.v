// SPDX-License-Identifier: Apache-2.0
//
// What the configuration port of a device does with the words on its pins, as far as a load can fail in
// it: sync word, packets, CRC, IDCODE, aborts (UG470 and UG570, "Configuration Details", "SelectMAP
// ABORT"). Compared word by word with the vendor's simulation models by tests/rtl/test_config_port.py.
//
// The bits of every byte arrive reversed. Until the sync word everything is ignored; a wrong CRC or IDCODE
// takes the port out of sync at once, and shows until the next sync word. RDWRB may change only while CSIB
// is high: else the port aborts, four clocks long, and must be given a sync word again.
`default_nettype none

module cm_config_port #(
    parameter [31:0] IDCODE = 32'd0  // of the device, its revision is not compared; 0 takes any
) (
    input  wire        clk,
    input  wire        csib,
    input  wire        rdwrb,
    input  wire [31:0] i,
    output wire [7:0]  status,  // CFGERR_B, DALIGN, RIP, IN_ABORT_B, 1111 as an abort shows them
    output reg         synced,
    output reg         failed,  // CRC or IDCODE
    output reg         aborting,
    output reg         prdone   // no frames are being written
);
    localparam [31:0] SYNC = 32'hAA995566;
    localparam [4:0] CRC = 5'd0, FDRI = 5'd2, CMD = 5'd4, ID = 5'd12;
    localparam [31:0] RCRC = 32'd7, DESYNC = 32'd13;

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
        end else if (!csib && !rdwrb) begin
            word = swapped(i);
            if (!synced) begin
                if (word == SYNC) begin
                    synced    <= 1'b1;
                    failed    <= 1'b0;
                    remaining <= 27'd0;
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
                    if (address == FDRI)
                        prdone <= 1'b0;
                    if (address == ID && differs(word)) begin
                        failed <= 1'b1;
                        synced <= 1'b0;
                    end
                end
            end else if (word[31:29] == 3'd1) begin
                address   <= word[17:13];
                remaining <= word[28:27] == 2'd2 ? {16'd0, word[10:0]} : 27'd0;
            end else if (word[31:29] == 3'd2) begin
                remaining <= word[28:27] == 2'd2 ? word[26:0] : 27'd0;  // to the register of the packet before
            end
        end
    end
endmodule

`default_nettype wire
