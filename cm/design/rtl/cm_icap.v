// SPDX-License-Identifier: Apache-2.0
//
// AXI4-Stream to the internal configuration access port. Words come as a little-endian bus
// delivers a word-swapped .bin (AA995566 is the sync word); the port wants the bits of every
// byte reversed (UG470 and UG570, "Bit Swapping"). RDWRB never changes, which would abort. A word
// waits as long as AVAIL is low, also when that falls in the very clock in which it was taken from the
// stream. Loads that failed show in `status` where the primitive tells (ICAPE3: PRERROR; ICAPE2: the
// status word's bits on O).
`default_nettype none

module cm_icap #(
    parameter ULTRASCALE = 0  // 0: ICAPE2 (7 series), 1: ICAPE3 (UltraScale, UltraScale+)
) (
    input  wire        clk,
    input  wire        resetn,
    input  wire        s_tvalid,
    output wire        s_tready,
    input  wire [31:0] s_tdata,
    input  wire        s_tlast,
    output wire [2:0]  status,  // [0] the last load ended, [1] error, [2] one is under way
    output reg  [31:0] words    // of the running or last load
);
    reg  [31:0] word;
    reg         pending, last, done, fresh;
    wire        available, failed;

    function [31:0] swap(input [31:0] x);
        integer byte_index, bit_index;
        begin
            for (byte_index = 0; byte_index < 4; byte_index = byte_index + 1)
                for (bit_index = 0; bit_index < 8; bit_index = bit_index + 1)
                    swap[byte_index*8+bit_index] = x[byte_index*8+7-bit_index];
        end
    endfunction

    wire csib = !(pending && available);
    assign s_tready = !pending || available;
    assign status   = {!fresh || pending, failed, done};

    always @(posedge clk) begin
        if (!resetn) begin
            pending <= 1'b0;
            last    <= 1'b0;
            word    <= 32'd0;
            words   <= 32'd0;
            done    <= 1'b0;
            fresh   <= 1'b1;
        end else begin
            if (!csib) begin
                pending <= 1'b0;
                done    <= last;
            end
            if (s_tvalid && s_tready) begin
                pending <= 1'b1;
                word    <= swap(s_tdata);
                last    <= s_tlast;
                words   <= fresh ? 32'd1 : words + 32'd1;
                fresh   <= s_tlast;
                if (fresh)
                    done <= 1'b0;
            end
        end
    end

    generate
        if (ULTRASCALE != 0) begin : ultrascale
            wire [31:0] unused_out;
            wire        unused_done;
            ICAPE3 port (
                .CLK(clk), .CSIB(csib), .RDWRB(1'b0), .I(word), .O(unused_out),
                .AVAIL(available), .PRDONE(unused_done), .PRERROR(failed)
            );
            wire unused = &{1'b0, unused_out, unused_done};
        end else begin : series7
            wire [31:0] out;
            ICAPE2 #(.ICAP_WIDTH("X32")) port (.CLK(clk), .CSIB(csib), .RDWRB(1'b0), .I(word), .O(out));
            assign available = 1'b1;
            // UG470: O[7] is CFGERR_B of a status word, whose bits 3, 1 and 0 are 1. The vendor's simulation
            // model shows 0 while RDWRB is low, which tells nothing.
            assign failed = done && !out[7] && out[3] && out[1] && out[0];
            wire unused = &{1'b0, out[31:8], out[6:4], out[2]};
        end
    endgenerate
endmodule

`default_nettype wire
