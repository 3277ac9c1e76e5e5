// SPDX-License-Identifier: Apache-2.0
//
// False colours of the luma: palette 0 grey, 1 heat (black, red, yellow, white), 2 cold (black,
// blue, cyan, white), 3 inverted grey. One pixel per clock, no memory.
`default_nettype none

module camera_colorise #(
    parameter LINE = 640  // not used: the same parameter as the other modules have
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

    // three ramps of 85 steps each, 3 per step
    wire [7:0] low    = ramp(grey, 8'd0);
    wire [7:0] middle = ramp(grey, 8'd85);
    wire [7:0] high   = ramp(grey, 8'd170);
    reg [23:0] colour;

    function [7:0] ramp(input [7:0] value, input [7:0] from);
        reg [7:0] above;
        begin
            above = value - from;
            ramp = value <= from ? 8'd0 : above >= 8'd85 ? 8'd255 : above * 8'd3;
        end
    endfunction

    always @* begin
        case (palette)
            2'd0: colour = {3{grey}};
            2'd1: colour = {low, middle, high};
            2'd2: colour = {high, middle, low};
            default: colour = {3{~grey}};
        endcase
    end

    always @(posedge clk) begin
        if (!resetn) begin
            m_axis_tvalid <= 1'b0;
            m_axis_tlast  <= 1'b0;
            m_axis_tdata  <= 32'd0;
            frames        <= 32'd0;
        end else begin
            if (s_axis_tready) m_axis_tvalid <= take;
            if (take) begin
                m_axis_tdata <= {8'd0, colour};
                m_axis_tlast <= s_axis_tlast;
                if (s_axis_tlast) frames <= frames + 32'd1;
            end
        end
    end

    camera_registers #(.ID(32'h434F4C4F)) registers (
        .clk(clk), .resetn(resetn),
        .s_axi_awaddr(s_axi_awaddr), .s_axi_awvalid(s_axi_awvalid), .s_axi_awready(s_axi_awready),
        .s_axi_wdata(s_axi_wdata), .s_axi_wstrb(s_axi_wstrb), .s_axi_wvalid(s_axi_wvalid), .s_axi_wready(s_axi_wready),
        .s_axi_bresp(s_axi_bresp), .s_axi_bvalid(s_axi_bvalid), .s_axi_bready(s_axi_bready),
        .s_axi_araddr(s_axi_araddr), .s_axi_arvalid(s_axi_arvalid), .s_axi_arready(s_axi_arready),
        .s_axi_rdata(s_axi_rdata), .s_axi_rresp(s_axi_rresp), .s_axi_rvalid(s_axi_rvalid), .s_axi_rready(s_axi_rready),
        .frames(frames), .focus(focus), .zoom(zoom), .threshold(threshold), .palette(palette)
    );

    wire unused = &{1'b0, focus, zoom, threshold, s_axis_tdata[31:24], weighted[7:0], LINE != 0};
endmodule

`default_nettype wire
