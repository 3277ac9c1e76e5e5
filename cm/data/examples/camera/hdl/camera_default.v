// SPDX-License-Identifier: Apache-2.0
//
// The camera's default module: pixels as they are, one clock later.
`default_nettype none

module camera_default (
    input  wire        clk,
    input  wire        resetn,
    // grey pixels in, the same out, a byte a beat; TLAST with the last one of a frame
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

    wire take = s_axis_tvalid && s_axis_tready;
    assign s_axis_tready = !m_axis_tvalid || m_axis_tready;

    always @(posedge clk) begin
        if (!resetn) begin
            m_axis_tvalid <= 1'b0;
            m_axis_tlast  <= 1'b0;
            m_axis_tdata  <= 8'd0;
        end else if (s_axis_tready) begin
            m_axis_tvalid <= take;
            if (take) begin
                m_axis_tdata <= s_axis_tdata;
                m_axis_tlast <= s_axis_tlast;
            end
        end
    end

    assign frame_done = m_axis_tvalid && m_axis_tready && m_axis_tlast;

    camera_registers #(.ID(32'h44454641)) registers (
        .clk(clk), .resetn(resetn),
        .s_axi_awaddr(s_axi_awaddr), .s_axi_awvalid(s_axi_awvalid), .s_axi_awready(s_axi_awready),
        .s_axi_wdata(s_axi_wdata), .s_axi_wstrb(s_axi_wstrb), .s_axi_wvalid(s_axi_wvalid), .s_axi_wready(s_axi_wready),
        .s_axi_bresp(s_axi_bresp), .s_axi_bvalid(s_axi_bvalid), .s_axi_bready(s_axi_bready),
        .s_axi_araddr(s_axi_araddr), .s_axi_arvalid(s_axi_arvalid), .s_axi_arready(s_axi_arready),
        .s_axi_rdata(s_axi_rdata), .s_axi_rresp(s_axi_rresp), .s_axi_rvalid(s_axi_rvalid), .s_axi_rready(s_axi_rready),
        .frame_done(frame_done), .focus(lens_focus), .zoom(lens_zoom), .threshold(threshold), .palette(palette)
    );

    wire unused = &{1'b0, threshold, palette};
endmodule

`default_nettype wire
