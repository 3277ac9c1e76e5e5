// SPDX-License-Identifier: Apache-2.0
//
// From memory to a region of every width from 8 to 512 bits and back, as the static part does it: a DMA's
// width (the next power of two), the region's, the DMA's again. Packets of random length, with gaps and
// stalls. On the way each byte must be where it belongs, TKEEP low only above a packet's last byte.
`timescale 1ns / 1ps

module width_check #(
    parameter REGION = 3,
    parameter DMA = 4,
    parameter PACKETS = 20,
    parameter SEED = 1
) (
    input  wire clk,
    input  wire resetn,
    output reg  done,
    output reg  failed
);
    reg                 a_valid;
    wire                a_ready;
    reg  [8*DMA-1:0]    a_data;
    reg  [DMA-1:0]      a_keep;
    reg                 a_last;
    wire                b_valid, b_ready, b_last;
    wire [8*REGION-1:0] b_data;
    wire [REGION-1:0]   b_keep;
    wire                c_valid, c_last;
    wire [8*DMA-1:0]    c_data;
    wire [DMA-1:0]      c_keep;
    reg                 gate, c_ready;

    cm_axis_width #(.IN_BYTES(DMA), .OUT_BYTES(REGION)) to_region (
        .clk(clk), .resetn(resetn), .s_tvalid(a_valid), .s_tready(a_ready), .s_tdata(a_data), .s_tkeep(a_keep),
        .s_tlast(a_last), .m_tvalid(b_valid), .m_tready(b_ready && gate), .m_tdata(b_data), .m_tkeep(b_keep),
        .m_tlast(b_last)
    );
    cm_axis_width #(.IN_BYTES(REGION), .OUT_BYTES(DMA)) from_region (
        .clk(clk), .resetn(resetn), .s_tvalid(b_valid && gate), .s_tready(b_ready), .s_tdata(b_data), .s_tkeep(b_keep),
        .s_tlast(b_last), .m_tvalid(c_valid), .m_tready(c_ready), .m_tdata(c_data), .m_tkeep(c_keep), .m_tlast(c_last)
    );

    // the byte at an offset of a packet
    function [7:0] byte_of(input integer packet, input integer offset);
        byte_of = (packet * 131 + offset * 7 + (offset >> 8) * 29 + 3);
    endfunction
    function integer length_of(input integer packet);
        length_of = 1 + ((packet * packet * 37 + packet * 11 + SEED * 5) % (5 * DMA + 3));
    endfunction

    integer seed, sent_packet, sent, lane, got_packet, got, mid_packet, mid, beats;
    initial begin
        seed = SEED;
        {sent_packet, sent, got_packet, got, mid_packet, mid, beats} = 0;
        {a_valid, done, failed, gate, c_ready} = 0;
    end

    task check(input [8*64-1:0] data, input [63:0] keep, input last, input integer lanes, input integer packet,
               input integer offset);
        integer i;
        for (i = 0; i < lanes; i = i + 1)
            if (offset + i < length_of(packet)) begin
                if (!keep[i] || data[8*i+:8] !== byte_of(packet, offset + i)) failed <= 1;
            end else if (keep[i] || !last) failed <= 1;
    endtask

    always @(posedge clk) if (resetn) begin
        gate <= $random(seed) % 4 != 0;
        c_ready <= $random(seed) % 3 != 0;
        // what is offered changes only once it is taken
        if (!a_valid || a_ready) begin
            if (a_valid) begin
                sent = sent + DMA;
                if (sent >= length_of(sent_packet)) begin
                    sent = 0;
                    sent_packet = sent_packet + 1;
                end
            end
            a_valid <= sent_packet < PACKETS && $random(seed) % 4 != 0;
            for (lane = 0; lane < DMA; lane = lane + 1) begin
                a_keep[lane] <= sent + lane < length_of(sent_packet);
                a_data[8*lane+:8] <= sent + lane < length_of(sent_packet) ? byte_of(sent_packet, sent + lane) : 8'hEE;
            end
            a_last <= sent + DMA >= length_of(sent_packet);
        end
        if (b_valid && b_ready && gate) begin
            check(b_data, b_keep, b_last, REGION, mid_packet, mid);
            if (b_last !== (mid + REGION >= length_of(mid_packet))) failed <= 1;
            mid = b_last ? 0 : mid + REGION;
            mid_packet = mid_packet + b_last;
        end
        if (c_valid && c_ready) begin
            check(c_data, c_keep, c_last, DMA, got_packet, got);
            if (c_last !== (got + DMA >= length_of(got_packet))) failed <= 1;
            got = c_last ? 0 : got + DMA;
            got_packet = got_packet + c_last;
        end
        done <= got_packet == PACKETS && mid_packet == PACKETS && sent_packet == PACKETS;
    end
endmodule

module tb_axis_width;
    localparam FIRST = 1, LAST = 64;
    reg clk = 0, resetn = 0;
    wire [LAST:FIRST] done, failed;
    integer index;
    always #5 clk = !clk;
    genvar width;
    generate
        for (width = FIRST; width <= LAST; width = width + 1) begin : of
            width_check #(.REGION(width), .DMA(1 << $clog2(width)), .SEED(width)) check (
                .clk(clk), .resetn(resetn), .done(done[width]), .failed(failed[width])
            );
        end
    endgenerate
    initial begin
        repeat (4) @(posedge clk);
        resetn = 1;
        // a few clocks more than all packets need: what comes after them is wrong
        for (index = 0; index < 4000 && !(&done); index = index + 1) @(posedge clk);
        repeat (40) @(posedge clk);
        for (index = FIRST; index <= LAST; index = index + 1)
            if (failed[index] || !done[index]) $display("%0d bits: done %b failed %b", 8 * index, done[index], failed[index]);
        if (&done && !(|failed)) $display("PASS %0d widths", LAST - FIRST + 1);
        $finish;
    end
endmodule
