// SPDX-License-Identifier: Apache-2.0
//
// Edge detection of LANES pixels a clock: 3x3 Sobel, |gx| + |gy| cut at 255; values below the threshold, and the
// border of the picture, are black. Byte for byte what camera_edge.v gives at a pixel a clock.
//
// The pixel right of a beat's last one comes with the next beat, and the line below it a line later: so nothing
// comes out for the first LINE / LANES + 1 beats of a picture, and as many follow its last one; meanwhile the next
// picture waits. Two lines of memory.
`default_nettype none

module edge_lanes #(
    parameter LINE  = 640,  // pixels in a line: a multiple of LANES, at least 2 * LANES, 4096 at most
    parameter LANES = 4     // pixels in a beat
) (
    input  wire                 clk,
    input  wire                 resetn,
    // grey pixels in, edges out, the first pixel in the low byte; TLAST with the last beat of a picture
    input  wire [8*LANES-1:0]   s_axis_tdata,
    input  wire                 s_axis_tvalid,
    output wire                 s_axis_tready,
    input  wire                 s_axis_tlast,
    output reg  [8*LANES-1:0]   m_axis_tdata,
    output reg                  m_axis_tvalid,
    input  wire                 m_axis_tready,
    output reg                  m_axis_tlast,
    // registers: see camera_registers.v
    input  wire [7:0]           s_axi_awaddr,
    input  wire                 s_axi_awvalid,
    output wire                 s_axi_awready,
    input  wire [31:0]          s_axi_wdata,
    input  wire [3:0]           s_axi_wstrb,
    input  wire                 s_axi_wvalid,
    output wire                 s_axi_wready,
    output wire [1:0]           s_axi_bresp,
    output wire                 s_axi_bvalid,
    input  wire                 s_axi_bready,
    input  wire [7:0]           s_axi_araddr,
    input  wire                 s_axi_arvalid,
    output wire                 s_axi_arready,
    output wire [31:0]          s_axi_rdata,
    output wire [1:0]           s_axi_rresp,
    output wire                 s_axi_rvalid,
    input  wire                 s_axi_rready,
    // one clock for each picture that has left
    (* X_INTERFACE_INFO = "xilinx.com:signal:interrupt:1.0 frame_done INTERRUPT" *)
    output wire                 frame_done
);
    localparam BEATS = LINE / LANES;
    localparam XBITS = $clog2(BEATS);
    localparam [12:0] LAG = BEATS + 1;

    wire [7:0] threshold;
    wire [3:0] focus, zoom;
    wire [1:0] palette;

    reg  [12:0] owed;      // beats that came in and did not go out yet
    reg         flushing;  // the picture's last beat is in
    wire        room = !m_axis_tvalid || m_axis_tready;
    wire        take = s_axis_tvalid && s_axis_tready;
    wire        full = owed == LAG;
    assign s_axis_tready = room && !flushing;

    reg  [XBITS-1:0]   x;      // of the beat that comes
    wire               last = {{32 - XBITS{1'b0}}, x} == BEATS - 1;  // of a line
    reg  [1:0]         lines;  // whole ones above it, 2 at most
    reg                tail;   // the last beat of a line waits for its place
    reg                kept;  // and the line above it is no border
    reg  [8*LANES-1:0] above [0:BEATS-1], top [0:BEATS-1];  // the lines one and two before
    wire [8*LANES-1:0] a = top[x], b = above[x], c = s_axis_tdata;
    reg  [8*LANES-1:0] a1, b1, c1;                          // the beat before
    reg  [7:0]         a2, b2, c2;                          // and the pixel before that

    // LANES + 2 columns of three pixels: the beat before with its neighbours left and right
    wire [8*LANES+15:0] upper = {a[7:0], a1, a2}, middle = {b[7:0], b1, b2}, lower = {c[7:0], c1, c2};
    wire [8*LANES-1:0]  cut;

    function [10:0] weighed(input [7:0] one, input [7:0] two, input [7:0] three);
        weighed = {3'd0, one} + {2'd0, two, 1'b0} + {3'd0, three};
    endfunction

    genvar i;
    generate
        for (i = 0; i < LANES; i = i + 1) begin : lane
            wire [7:0] p0 = upper[8*i+:8], p1 = upper[8*i+8+:8], p2 = upper[8*i+16+:8];
            wire [7:0] q0 = middle[8*i+:8], q2 = middle[8*i+16+:8];
            wire [7:0] r0 = lower[8*i+:8], r1 = lower[8*i+8+:8], r2 = lower[8*i+16+:8];
            wire [10:0] left = weighed(p0, q0, r0), right = weighed(p2, q2, r2);
            wire [10:0] high = weighed(p0, p1, p2), low = weighed(r0, r1, r2);
            wire [10:0] gx = left < right ? right - left : left - right;
            wire [10:0] gy = high < low ? low - high : high - low;
            wire [10:0] magnitude = gx + gy;
            wire [7:0]  value = magnitude > 11'd255 ? 8'd255 : magnitude[7:0];
            wire        framed = tail ? kept && i != LANES - 1 : lines[1] && (x != 1 || i != 0);
            assign cut[8*i+:8] = framed && value >= threshold ? value : 8'd0;
        end
    endgenerate

    always @(posedge clk) begin
        if (take) begin
            top[x]   <= b;
            above[x] <= c;
        end
    end

    always @(posedge clk) begin
        if (!resetn) begin
            m_axis_tvalid <= 1'b0;
            m_axis_tlast  <= 1'b0;
            m_axis_tdata  <= {8*LANES{1'b0}};
            owed          <= 13'd0;
            flushing      <= 1'b0;
            x             <= {XBITS{1'b0}};
            lines         <= 2'd0;
            {tail, kept} <= 2'b00;
            {a1, b1, c1}  <= {24*LANES{1'b0}};
            {a2, b2, c2}  <= 24'd0;
        end else if (room) begin
            m_axis_tvalid <= (take && full) || flushing;
            m_axis_tdata  <= flushing && !tail ? {8*LANES{1'b0}} : cut;
            m_axis_tlast  <= flushing && owed == 13'd1;
            if (flushing) begin
                owed     <= owed - 13'd1;
                flushing <= owed != 13'd1;
                tail     <= 1'b0;
            end else if (take) begin
                if (!full) owed <= owed + 13'd1;
                flushing     <= s_axis_tlast;
                {a2, b2, c2} <= {a1[8*LANES-1-:8], b1[8*LANES-1-:8], c1[8*LANES-1-:8]};
                {a1, b1, c1} <= {a, b, c};
                tail         <= last || s_axis_tlast;
                kept       <= lines[1];
                x            <= (last || s_axis_tlast) ? {XBITS{1'b0}} : x + 1'b1;
                if (s_axis_tlast) lines <= 2'd0;
                else if (last && !lines[1]) lines <= lines + 2'd1;
            end
        end
    end

    assign frame_done = m_axis_tvalid && m_axis_tready && m_axis_tlast;

    camera_registers #(.ID(32'h344C4E45)) registers (
        .clk(clk), .resetn(resetn),
        .s_axi_awaddr(s_axi_awaddr), .s_axi_awvalid(s_axi_awvalid), .s_axi_awready(s_axi_awready),
        .s_axi_wdata(s_axi_wdata), .s_axi_wstrb(s_axi_wstrb), .s_axi_wvalid(s_axi_wvalid), .s_axi_wready(s_axi_wready),
        .s_axi_bresp(s_axi_bresp), .s_axi_bvalid(s_axi_bvalid), .s_axi_bready(s_axi_bready),
        .s_axi_araddr(s_axi_araddr), .s_axi_arvalid(s_axi_arvalid), .s_axi_arready(s_axi_arready),
        .s_axi_rdata(s_axi_rdata), .s_axi_rresp(s_axi_rresp), .s_axi_rvalid(s_axi_rvalid), .s_axi_rready(s_axi_rready),
        .frame_done(frame_done), .focus(focus), .zoom(zoom), .threshold(threshold), .palette(palette)
    );

    wire unused = &{1'b0, focus, zoom, palette};
endmodule

`default_nettype wire
