// SPDX-License-Identifier: Apache-2.0
//
// Edge detection: Sobel on luma, |gx| + |gy| against the threshold, white on black. The window
// trails the pixel that comes in: the output at (x, y) belongs to the centre (x-1, y-1), and the
// first two lines and columns of a frame are black. One pixel per clock, two lines of memory.
`default_nettype none

module camera_edge #(
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
    input  wire        s_axi_rready,
    output reg         frame_done_irq  // one clock per frame
);
    localparam ABITS = $clog2(LINE);

    wire [3:0]  focus;
    wire [1:0]  zoom;
    wire [7:0]  threshold;
    wire [1:0]  palette;
    reg  [31:0] frames;

    wire take = s_axis_tvalid && s_axis_tready;
    assign s_axis_tready = !m_axis_tvalid || m_axis_tready;

    // luma by 77 R + 150 G + 29 B (BT.601, 8 bits)
    wire [15:0] weighted = 16'd77 * {8'd0, s_axis_tdata[23:16]} + 16'd150 * {8'd0, s_axis_tdata[15:8]}
                         + 16'd29 * {8'd0, s_axis_tdata[7:0]};
    wire [7:0]  grey = weighted[15:8];

    reg  [11:0] x, y;
    reg  [7:0]  above [0:LINE-1], top [0:LINE-1];  // the lines one and two before
    wire [7:0]  a = top[x[ABITS-1:0]], b = above[x[ABITS-1:0]];
    reg  [7:0]  a1, a2, b1, b2, c1, c2;            // the two columns before

    wire signed [10:0] gx = tap(a) + tap2(b) + tap(grey) - tap(a2) - tap2(b2) - tap(c2);
    wire signed [10:0] gy = tap(c2) + tap2(c1) + tap(grey) - tap(a2) - tap2(a1) - tap(a);
    wire        [10:0] magnitude = (gx < 0 ? -gx : gx) + (gy < 0 ? -gy : gy);
    wire               framed = x > 12'd1 && y > 12'd1;
    wire               is_edge = framed && magnitude > {3'd0, threshold};

    function signed [10:0] tap(input [7:0] value);
        tap = $signed({3'd0, value});
    endfunction

    function signed [10:0] tap2(input [7:0] value);
        tap2 = $signed({2'd0, value, 1'b0});
    endfunction

    always @(posedge clk) begin
        if (take) begin
            top[x[ABITS-1:0]]   <= b;
            above[x[ABITS-1:0]] <= grey;
        end
    end

    always @(posedge clk) begin
        if (!resetn) begin
            m_axis_tvalid  <= 1'b0;
            m_axis_tlast   <= 1'b0;
            m_axis_tdata   <= 32'd0;
            frames         <= 32'd0;
            frame_done_irq <= 1'b0;
            x              <= 12'd0;
            y              <= 12'd0;
            {a1, a2, b1, b2, c1, c2} <= 48'd0;
        end else begin
            frame_done_irq <= take && s_axis_tlast;
            if (s_axis_tready) m_axis_tvalid <= take;
            if (take) begin
                m_axis_tdata <= is_edge ? 32'h00FFFFFF : 32'd0;
                m_axis_tlast <= s_axis_tlast;
                {a2, b2, c2} <= {a1, b1, c1};
                {a1, b1, c1} <= {a, b, grey};
                x            <= (x == LINE - 1 || s_axis_tlast) ? 12'd0 : x + 12'd1;
                if (s_axis_tlast) begin
                    y      <= 12'd0;
                    frames <= frames + 32'd1;
                end else if (x == LINE - 1) y <= y + 12'd1;
            end
        end
    end

    camera_registers #(.ID(32'h45444745)) registers (
        .clk(clk), .resetn(resetn),
        .s_axi_awaddr(s_axi_awaddr), .s_axi_awvalid(s_axi_awvalid), .s_axi_awready(s_axi_awready),
        .s_axi_wdata(s_axi_wdata), .s_axi_wstrb(s_axi_wstrb), .s_axi_wvalid(s_axi_wvalid), .s_axi_wready(s_axi_wready),
        .s_axi_bresp(s_axi_bresp), .s_axi_bvalid(s_axi_bvalid), .s_axi_bready(s_axi_bready),
        .s_axi_araddr(s_axi_araddr), .s_axi_arvalid(s_axi_arvalid), .s_axi_arready(s_axi_arready),
        .s_axi_rdata(s_axi_rdata), .s_axi_rresp(s_axi_rresp), .s_axi_rvalid(s_axi_rvalid), .s_axi_rready(s_axi_rready),
        .frames(frames), .focus(focus), .zoom(zoom), .threshold(threshold), .palette(palette)
    );

    wire unused = &{1'b0, focus, zoom, palette, s_axis_tdata[31:24], weighted[7:0]};
endmodule

`default_nettype wire
