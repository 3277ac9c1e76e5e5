// SPDX-License-Identifier: Apache-2.0
//
// Frames of LINES lines of WORDS words as AXI VDMA wants them: TUSER at the first word, TLAST at the end of each line.
`default_nettype none

module frames #(
    parameter LINES = 480,
    parameter WORDS = 160
) (
    input  wire        clk,
    input  wire        resetn,
    output wire [31:0] m_axis_tdata,
    output wire [0:0]  m_axis_tuser,
    output wire        m_axis_tvalid,
    input  wire        m_axis_tready,
    output wire        m_axis_tlast
);

    reg [15:0] line;
    reg [15:0] word;

    assign m_axis_tdata  = {line, word};
    assign m_axis_tuser  = line == 16'd0 && word == 16'd0;
    assign m_axis_tlast  = word == WORDS[15:0] - 16'd1;
    assign m_axis_tvalid = resetn;

    always @(posedge clk) begin
        if (!resetn) begin
            line <= 16'd0;
            word <= 16'd0;
        end else if (m_axis_tready) begin
            word <= m_axis_tlast ? 16'd0 : word + 16'd1;
            if (m_axis_tlast)
                line <= line == LINES[15:0] - 16'd1 ? 16'd0 : line + 16'd1;
        end
    end

endmodule

`default_nettype wire
