// SPDX-License-Identifier: Apache-2.0
// Frames of 24 lines of 32 pixels {line, column, number}, as a bad source sends them: three pixels of none, a frame
// that is cut short after two lines, one whose line 3 is short and whose line 5 is long, and good ones from then on.
module unruly (
    input  logic        ap_clk,
    input  logic        ap_rst_n,
    output logic [23:0] output_r_TDATA,
    output logic [2:0]  output_r_TKEEP,
    output logic [0:0]  output_r_TUSER,
    output logic        output_r_TLAST,
    output logic        output_r_TVALID,
    input  logic        output_r_TREADY
);
    logic [1:0] junk;
    logic [7:0] number, line, column;
    wire  [7:0] lines = number == 0 ? 8'd2 : 8'd24;
    wire  [7:0] columns = number != 1 ? 8'd32 : line == 3 ? 8'd30 : line == 5 ? 8'd35 : 8'd32;
    wire        wild = junk != 2'd3;

    assign output_r_TVALID = 1'b1;
    assign output_r_TKEEP  = 3'b111;
    assign output_r_TUSER  = !wild && line == 0 && column == 0;
    assign output_r_TLAST  = !wild && column == columns - 1;
    assign output_r_TDATA  = wild ? 24'hAAAAAA : {number, column, line};

    always_ff @(posedge ap_clk)
        if (!ap_rst_n) begin
            junk   <= 2'd0;
            number <= 8'd0;
            line   <= 8'd0;
            column <= 8'd0;
        end else if (output_r_TREADY) begin
            if (wild)
                junk <= junk + 2'd1;
            else if (column != columns - 1)
                column <= column + 8'd1;
            else begin
                column <= 8'd0;
                line   <= line == lines - 1 ? 8'd0 : line + 8'd1;
                if (line == lines - 1)
                    number <= number + 8'd1;
            end
        end
endmodule
