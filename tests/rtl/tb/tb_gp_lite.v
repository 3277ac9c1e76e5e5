// SPDX-License-Identifier: Apache-2.0
// The bridge of the open flow with the signals that an AXI master has and the bridge does not look at.
`default_nettype none
module tb_gp_lite (
    input wire clk, input wire resetn,
    input wire [11:0] s_awid, input wire [31:0] s_awaddr, input wire [7:0] s_awlen, input wire [2:0] s_awsize,
    input wire [1:0] s_awburst, input wire s_awvalid, output wire s_awready,
    input wire [31:0] s_wdata, input wire [3:0] s_wstrb, input wire s_wlast, input wire s_wvalid, output wire s_wready,
    output wire [11:0] s_bid, output wire [1:0] s_bresp, output wire s_bvalid, input wire s_bready,
    input wire [11:0] s_arid, input wire [31:0] s_araddr, input wire [7:0] s_arlen, input wire [2:0] s_arsize,
    input wire [1:0] s_arburst, input wire s_arvalid, output wire s_arready,
    output wire [11:0] s_rid, output wire [31:0] s_rdata, output wire [1:0] s_rresp, output wire s_rlast,
    output wire s_rvalid, input wire s_rready,
    output wire [31:0] m_awaddr, output wire [2:0] m_awprot, output wire m_awvalid, input wire m_awready,
    output wire [31:0] m_wdata, output wire [3:0] m_wstrb, output wire m_wvalid, input wire m_wready,
    input wire [1:0] m_bresp, input wire m_bvalid, output wire m_bready,
    output wire [31:0] m_araddr, output wire [2:0] m_arprot, output wire m_arvalid, input wire m_arready,
    input wire [31:0] m_rdata, input wire [1:0] m_rresp, input wire m_rvalid, output wire m_rready
);
    cm_gp_lite bridge (
        .clk(clk), .resetn(resetn),
        .s_awaddr(s_awaddr), .s_awid(s_awid), .s_awvalid(s_awvalid), .s_awready(s_awready),
        .s_wdata(s_wdata), .s_wstrb(s_wstrb), .s_wlast(s_wlast), .s_wvalid(s_wvalid), .s_wready(s_wready),
        .s_bid(s_bid), .s_bresp(s_bresp), .s_bvalid(s_bvalid), .s_bready(s_bready),
        .s_araddr(s_araddr), .s_arid(s_arid), .s_arlen(s_arlen[3:0]), .s_arvalid(s_arvalid), .s_arready(s_arready),
        .s_rdata(s_rdata), .s_rid(s_rid), .s_rresp(s_rresp), .s_rlast(s_rlast), .s_rvalid(s_rvalid), .s_rready(s_rready),
        .m_awaddr(m_awaddr), .m_awprot(m_awprot), .m_awvalid(m_awvalid), .m_awready(m_awready),
        .m_wdata(m_wdata), .m_wstrb(m_wstrb), .m_wvalid(m_wvalid), .m_wready(m_wready),
        .m_bresp(m_bresp), .m_bvalid(m_bvalid), .m_bready(m_bready),
        .m_araddr(m_araddr), .m_arprot(m_arprot), .m_arvalid(m_arvalid), .m_arready(m_arready),
        .m_rdata(m_rdata), .m_rresp(m_rresp), .m_rvalid(m_rvalid), .m_rready(m_rready)
    );
endmodule
`default_nettype wire
