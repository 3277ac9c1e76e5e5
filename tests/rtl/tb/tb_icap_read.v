// SPDX-License-Identifier: Apache-2.0
//
// Words of words.hex to cm_icap_read, and its answers as lines: bit 32 of a word ends a packet, bit 33 waits for an
// answer behind it. Plain Verilog, so that Icarus and Verilator run it, at our models of the port or at the vendor's.
`timescale 1ps/1ps

module tb_icap_read;
    parameter ULTRASCALE = 0;
    parameter COUNT = 1;
    parameter START = 100000;  // the vendor's port needs some clocks
    reg clk = 0, resetn = 0, valid = 0, ready = 0;
    reg [33:0] words [0:COUNT-1];
    integer n = 0, answers = 0, asked = 0, seed = 11;
    wire s_ready, m_valid, m_last;
    wire [31:0] m_data, count;
    wire [2:0] status;
    always #5000 clk = ~clk;

    cm_icap_read #(.ULTRASCALE(ULTRASCALE), .DEPTH_BITS(10)) dut (
        .clk(clk), .resetn(resetn), .s_tvalid(valid), .s_tready(s_ready), .s_tdata(words[n][31:0]),
        .s_tlast(words[n][32]), .m_tvalid(m_valid), .m_tready(ready), .m_tdata(m_data), .m_tlast(m_last),
        .status(status), .words(count)
    );

    initial begin
        $readmemh("words.hex", words);
        #START @(negedge clk) resetn = 1;
    end

    always @(negedge clk) if (resetn) begin  // between the edges, so that order within a time step matters to nobody
        ready = $random(seed) % 3 != 0;
        if (n == COUNT && answers == asked && status[0]) begin
            $display("status %b", status);
            $finish;
        end
        valid = n < COUNT && answers == asked && $random(seed) % 4 != 0;
    end
    always @(posedge clk) if (resetn) begin
        if (m_valid && ready) begin
            $display("word %h %b", m_data, m_last);
            if (m_last) answers = answers + 1;
        end
        if (valid && s_ready) begin
            if (words[n][33]) asked = asked + 1;
            n = n + 1;
        end
    end
    initial #2000000000 begin $display("hung after %0d", n); $finish; end
endmodule
