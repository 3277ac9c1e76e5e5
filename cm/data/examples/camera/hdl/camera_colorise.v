// SPDX-License-Identifier: Apache-2.0
//
// False colours: red, green and blue of a palette for each grey pixel, three bytes for one. The same as
// `colorise` of the simulated board, bit by bit; v being the grey value, and every result cut to 0..255:
//   0 heat    3v, 3v - 255, 3v - 510          2 rainbow  255 - |4v - 765|, 255 - |4v - 510|, 255 - |4v - 255|
//   1 cold    3v - 510, 3v - 255, 3v          3 grey     v, v, v
`default_nettype none

module camera_colorise (
    input  wire        clk,
    input  wire        resetn,
    // grey pixels in, red, green, blue out, a byte a beat; TLAST with the last one of a frame
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
    wire [7:0] threshold;
    wire [1:0] palette;

    reg [1:0] channel;  // of the byte that goes out next: red, green, blue
    reg [7:0] pixel;
    reg       last;     // of the frame
    reg       busy;     // green and blue of `pixel` are still to come

    wire room = !m_axis_tvalid || m_axis_tready;
    wire take = s_axis_tvalid && s_axis_tready;
    assign s_axis_tready = room && !busy;
    wire [7:0] value = busy ? pixel : s_axis_tdata;

    // Heat counts its channels from red, cold from blue.
    wire        [1:0]  step = palette == 2'd1 ? 2'd2 - channel : channel;
    wire signed [11:0] ramp = $signed({4'd0, value}) * 12'sd3 - $signed({10'd0, step}) * 12'sd255;
    wire signed [11:0] from_peak = $signed({2'd0, value, 2'd0}) - 12'sd765 + $signed({10'd0, channel}) * 12'sd255;
    wire signed [11:0] peak = 12'sd255 - (from_peak < 0 ? -from_peak : from_peak);
    wire signed [11:0] chosen = palette == 2'd2 ? peak : palette == 2'd3 ? $signed({4'd0, value}) : ramp;

    always @(posedge clk) begin
        if (!resetn) begin
            m_axis_tvalid <= 1'b0;
            m_axis_tlast  <= 1'b0;
            m_axis_tdata  <= 8'd0;
            channel       <= 2'd0;
            pixel         <= 8'd0;
            last          <= 1'b0;
            busy          <= 1'b0;
        end else if (room) begin
            m_axis_tvalid <= take || busy;
            m_axis_tdata  <= chosen < 0 ? 8'd0 : chosen > 255 ? 8'd255 : chosen[7:0];
            m_axis_tlast  <= busy && channel == 2'd2 && last;
            if (take) begin
                pixel <= s_axis_tdata;
                last  <= s_axis_tlast;
                busy  <= 1'b1;
            end else if (channel == 2'd2) busy <= 1'b0;
            if (take || busy) channel <= channel == 2'd2 ? 2'd0 : channel + 2'd1;
        end
    end

    assign frame_done = m_axis_tvalid && m_axis_tready && m_axis_tlast;

    camera_registers #(.ID(32'h434F4C4F)) registers (
        .clk(clk), .resetn(resetn),
        .s_axi_awaddr(s_axi_awaddr), .s_axi_awvalid(s_axi_awvalid), .s_axi_awready(s_axi_awready),
        .s_axi_wdata(s_axi_wdata), .s_axi_wstrb(s_axi_wstrb), .s_axi_wvalid(s_axi_wvalid), .s_axi_wready(s_axi_wready),
        .s_axi_bresp(s_axi_bresp), .s_axi_bvalid(s_axi_bvalid), .s_axi_bready(s_axi_bready),
        .s_axi_araddr(s_axi_araddr), .s_axi_arvalid(s_axi_arvalid), .s_axi_arready(s_axi_arready),
        .s_axi_rdata(s_axi_rdata), .s_axi_rresp(s_axi_rresp), .s_axi_rvalid(s_axi_rvalid), .s_axi_rready(s_axi_rready),
        .frame_done(frame_done), .focus(lens_focus), .zoom(lens_zoom), .threshold(threshold), .palette(palette)
    );

    wire unused = &{1'b0, threshold};
endmodule

`default_nettype wire
