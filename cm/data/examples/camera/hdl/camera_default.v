// SPDX-License-Identifier: Apache-2.0
//
// The camera's default module: sharpens along the line (focus) and shows blocks of 2^zoom by
// 2^zoom pixels. One pixel per clock, one clock of latency, one line of memory.
//   out = clamp(p + focus * (p - left) / 16), left being the pixel before; then the block's first.
`default_nettype none

module camera_default #(
    parameter LINE = 640  // pixels in a line, at most 4096
) (
    input  wire        clk,
    input  wire        resetn,
    // pixels in and out: 0x00RRGGBB, TLAST with the last one of a frame
    input  wire [31:0] s_axis_tdata,
    input  wire        s_axis_tvalid,
    output wire        s_axis_tready,
    input  wire        s_axis_tlast,
    output reg  [31:0] m_axis_tdata,
    output reg         m_axis_tvalid,
    input  wire        m_axis_tready,
    output reg         m_axis_tlast,
    // registers: see camera_registers.v
    input  wire [7:0]  s_axi_awaddr,
    input  wire        s_axi_awvalid,
    output wire        s_axi_awready,
    input  wire [31:0] s_axi_wdata,
    input  wire [3:0]  s_axi_wstrb,
    input  wire        s_axi_wvalid,
    output wire        s_axi_wready,
    output wire [1:0]  s_axi_bresp,
    output wire        s_axi_bvalid,
    input  wire        s_axi_bready,
    input  wire [7:0]  s_axi_araddr,
    input  wire        s_axi_arvalid,
    output wire        s_axi_arready,
    output wire [31:0] s_axi_rdata,
    output wire [1:0]  s_axi_rresp,
    output wire        s_axi_rvalid,
    input  wire        s_axi_rready
);
    localparam ABITS = $clog2(LINE);

    wire [3:0]  focus;
    wire [1:0]  zoom;
    wire [7:0]  threshold;
    wire [1:0]  palette;
    reg  [31:0] frames;

    wire take = s_axis_tvalid && s_axis_tready;
    assign s_axis_tready = !m_axis_tvalid || m_axis_tready;

    reg  [11:0] x, y;
    reg  [31:0] left;
    reg  [23:0] held;                // the block's pixel in this line
    reg  [23:0] line [0:LINE-1];     // the pixels of the block's first line
    wire [2:0]  mask = (3'd1 << zoom) - 3'd1;
    wire        first_x = (x[2:0] & mask) == 3'd0;
    wire        first_y = (y[2:0] & mask) == 3'd0;
    wire [23:0] sharp = {
        sharpen(s_axis_tdata[23:16], left[23:16], focus),
        sharpen(s_axis_tdata[15:8], left[15:8], focus),
        sharpen(s_axis_tdata[7:0], left[7:0], focus)
    };
    wire [23:0] pixel = !first_y ? line[x[ABITS-1:0]] : first_x ? sharp : held;

    function [7:0] sharpen(input [7:0] p, input [7:0] l, input [3:0] strength);
        reg signed [14:0] difference, sum;
        begin
            difference = ($signed({7'd0, p}) - $signed({7'd0, l})) * $signed({11'd0, strength});
            sum = $signed({7'd0, p}) + (difference >>> 4);
            sharpen = sum < 0 ? 8'd0 : sum > 255 ? 8'd255 : sum[7:0];
        end
    endfunction

    always @(posedge clk) begin
        if (take && first_y) line[x[ABITS-1:0]] <= pixel;
    end

    always @(posedge clk) begin
        if (!resetn) begin
            m_axis_tvalid <= 1'b0;
            m_axis_tlast  <= 1'b0;
            m_axis_tdata  <= 32'd0;
            frames        <= 32'd0;
            x             <= 12'd0;
            y             <= 12'd0;
            left          <= 32'd0;
            held          <= 24'd0;
        end else begin
            if (s_axis_tready) m_axis_tvalid <= take;
            if (take) begin
                m_axis_tdata <= {8'd0, pixel};
                m_axis_tlast <= s_axis_tlast;
                left         <= x == LINE - 1 ? 32'd0 : s_axis_tdata;
                held         <= pixel;
                x            <= (x == LINE - 1 || s_axis_tlast) ? 12'd0 : x + 12'd1;
                if (s_axis_tlast) begin
                    y      <= 12'd0;
                    left   <= 32'd0;
                    frames <= frames + 32'd1;
                end else if (x == LINE - 1) y <= y + 12'd1;
            end
        end
    end

    camera_registers #(.ID(32'h44454641)) registers (
        .clk(clk), .resetn(resetn),
        .s_axi_awaddr(s_axi_awaddr), .s_axi_awvalid(s_axi_awvalid), .s_axi_awready(s_axi_awready),
        .s_axi_wdata(s_axi_wdata), .s_axi_wstrb(s_axi_wstrb), .s_axi_wvalid(s_axi_wvalid), .s_axi_wready(s_axi_wready),
        .s_axi_bresp(s_axi_bresp), .s_axi_bvalid(s_axi_bvalid), .s_axi_bready(s_axi_bready),
        .s_axi_araddr(s_axi_araddr), .s_axi_arvalid(s_axi_arvalid), .s_axi_arready(s_axi_arready),
        .s_axi_rdata(s_axi_rdata), .s_axi_rresp(s_axi_rresp), .s_axi_rvalid(s_axi_rvalid), .s_axi_rready(s_axi_rready),
        .frames(frames), .focus(focus), .zoom(zoom), .threshold(threshold), .palette(palette)
    );

    wire unused = &{1'b0, threshold, palette, left[31:24], s_axis_tdata[31:24], y[11:3]};
endmodule

`default_nettype wire
