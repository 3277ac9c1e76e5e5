// SPDX-License-Identifier: Apache-2.0
//
// Edge detection: 3x3 Sobel, |gx| + |gy| cut at 255; values below the threshold, and the border of the
// frame, are black. The same as `edge` of the simulated board, bit by bit.
//
// A pixel's neighbours are complete when the one below and to the right of it comes, a line and a pixel
// later. So nothing comes out for the first LINE + 1 pixels of a frame, and as many, all of them border,
// follow its last one; meanwhile the next frame waits. Two lines of memory.
`default_nettype none

module camera_edge #(
    parameter LINE = 640  // pixels in a line, 3 to 4096
) (
    input  wire        clk,
    input  wire        resetn,
    // grey pixels in, edges out, a byte a beat; TLAST with the last one of a frame
    input  wire [7:0]  s_axis_tdata,
    input  wire        s_axis_tvalid,
    output wire        s_axis_tready,
    input  wire        s_axis_tlast,
    output reg  [7:0]  m_axis_tdata,
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
    input  wire        s_axi_rready,
    // to the sensor
    output wire [3:0]  lens_focus,
    output wire [3:0]  lens_zoom,
    // one clock for each frame that has left
    (* X_INTERFACE_INFO = "xilinx.com:signal:interrupt:1.0 frame_done INTERRUPT" *)
    output wire        frame_done
);
    localparam ABITS = $clog2(LINE);
    localparam [12:0] LAG = LINE + 1;

    wire [7:0] threshold;
    wire [1:0] palette;

    reg  [12:0] owed;      // pixels that came in and did not go out yet
    reg         flushing;  // the frame's last pixel is in
    wire        room = !m_axis_tvalid || m_axis_tready;
    wire        take = s_axis_tvalid && s_axis_tready;
    wire        full = owed == LAG;
    assign s_axis_tready = room && !flushing;

    reg  [11:0] x, y;
    reg  [7:0]  above [0:LINE-1], top [0:LINE-1];  // the lines one and two before
    wire [7:0]  a = top[x[ABITS-1:0]], b = above[x[ABITS-1:0]], c = s_axis_tdata;
    reg  [7:0]  a1, a2, b1, b2, c1, c2;            // the two columns before

    wire signed [10:0] gx = tap(a) + tap2(b) + tap(c) - tap(a2) - tap2(b2) - tap(c2);
    wire signed [10:0] gy = tap(c2) + tap2(c1) + tap(c) - tap(a2) - tap2(a1) - tap(a);
    wire        [10:0] magnitude = (gx < 0 ? -gx : gx) + (gy < 0 ? -gy : gy);
    wire        [7:0]  cut = magnitude > 11'd255 ? 8'd255 : magnitude[7:0];
    wire               framed = x > 12'd1 && y > 12'd1;

    function signed [10:0] tap(input [7:0] value);
        tap = $signed({3'd0, value});
    endfunction

    function signed [10:0] tap2(input [7:0] value);
        tap2 = $signed({2'd0, value, 1'b0});
    endfunction

    always @(posedge clk) begin
        if (take) begin
            top[x[ABITS-1:0]]   <= b;
            above[x[ABITS-1:0]] <= c;
        end
    end

    always @(posedge clk) begin
        if (!resetn) begin
            m_axis_tvalid <= 1'b0;
            m_axis_tlast  <= 1'b0;
            m_axis_tdata  <= 8'd0;
            owed          <= 13'd0;
            flushing      <= 1'b0;
            x             <= 12'd0;
            y             <= 12'd0;
            {a1, a2, b1, b2, c1, c2} <= 48'd0;
        end else if (room) begin
            m_axis_tvalid <= (take && full) || flushing;
            m_axis_tdata  <= framed && !flushing && cut >= threshold ? cut : 8'd0;
            m_axis_tlast  <= flushing && owed == 13'd1;
            if (flushing) begin
                owed     <= owed - 13'd1;
                flushing <= owed != 13'd1;
            end else if (take) begin
                if (!full) owed <= owed + 13'd1;
                flushing     <= s_axis_tlast;
                {a2, b2, c2} <= {a1, b1, c1};
                {a1, b1, c1} <= {a, b, c};
                x            <= (x == LINE - 1 || s_axis_tlast) ? 12'd0 : x + 12'd1;
                if (s_axis_tlast) y <= 12'd0;
                else if (x == LINE - 1) y <= y + 12'd1;
            end
        end
    end

    assign frame_done = m_axis_tvalid && m_axis_tready && m_axis_tlast;

    camera_registers #(.ID(32'h45444745)) registers (
        .clk(clk), .resetn(resetn),
        .s_axi_awaddr(s_axi_awaddr), .s_axi_awvalid(s_axi_awvalid), .s_axi_awready(s_axi_awready),
        .s_axi_wdata(s_axi_wdata), .s_axi_wstrb(s_axi_wstrb), .s_axi_wvalid(s_axi_wvalid), .s_axi_wready(s_axi_wready),
        .s_axi_bresp(s_axi_bresp), .s_axi_bvalid(s_axi_bvalid), .s_axi_bready(s_axi_bready),
        .s_axi_araddr(s_axi_araddr), .s_axi_arvalid(s_axi_arvalid), .s_axi_arready(s_axi_arready),
        .s_axi_rdata(s_axi_rdata), .s_axi_rresp(s_axi_rresp), .s_axi_rvalid(s_axi_rvalid), .s_axi_rready(s_axi_rready),
        .frame_done(frame_done), .focus(lens_focus), .zoom(lens_zoom), .threshold(threshold), .palette(palette)
    );

    wire unused = &{1'b0, palette};
endmodule

`default_nettype wire
