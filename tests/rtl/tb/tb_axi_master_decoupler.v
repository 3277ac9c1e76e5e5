// SPDX-License-Identifier: Apache-2.0
//
// cm_axi_master_decoupler with the ports of two AXI4 interfaces: s_axi region side, m_axi static side.
`timescale 1ns / 1ps
`default_nettype none

module tb_axi_master_decoupler (
    input  wire        clk,
    input  wire        resetn,
    input  wire        region_resetn,  // for the model of the region
    input  wire        decouple,
    output wire        decoupled,
    input  wire [3:0]  s_axi_awid,
    input  wire [15:0] s_axi_awaddr,
    input  wire [7:0]  s_axi_awlen,
    input  wire [2:0]  s_axi_awsize,
    input  wire [1:0]  s_axi_awburst,
    input  wire [2:0]  s_axi_awprot,
    input  wire        s_axi_awvalid,
    output wire        s_axi_awready,
    input  wire [31:0] s_axi_wdata,
    input  wire [3:0]  s_axi_wstrb,
    input  wire        s_axi_wlast,
    input  wire        s_axi_wvalid,
    output wire        s_axi_wready,
    output wire [3:0]  s_axi_bid,
    output wire [1:0]  s_axi_bresp,
    output wire        s_axi_bvalid,
    input  wire        s_axi_bready,
    input  wire [3:0]  s_axi_arid,
    input  wire [15:0] s_axi_araddr,
    input  wire [7:0]  s_axi_arlen,
    input  wire [2:0]  s_axi_arsize,
    input  wire [1:0]  s_axi_arburst,
    input  wire [2:0]  s_axi_arprot,
    input  wire        s_axi_arvalid,
    output wire        s_axi_arready,
    output wire [3:0]  s_axi_rid,
    output wire [31:0] s_axi_rdata,
    output wire [1:0]  s_axi_rresp,
    output wire        s_axi_rlast,
    output wire        s_axi_rvalid,
    input  wire        s_axi_rready,
    output wire [3:0]  m_axi_awid,
    output wire [15:0] m_axi_awaddr,
    output wire [7:0]  m_axi_awlen,
    output wire [2:0]  m_axi_awsize,
    output wire [1:0]  m_axi_awburst,
    output wire [2:0]  m_axi_awprot,
    output wire        m_axi_awvalid,
    input  wire        m_axi_awready,
    output wire [31:0] m_axi_wdata,
    output wire [3:0]  m_axi_wstrb,
    output wire        m_axi_wlast,
    output wire        m_axi_wvalid,
    input  wire        m_axi_wready,
    input  wire [3:0]  m_axi_bid,
    input  wire [1:0]  m_axi_bresp,
    input  wire        m_axi_bvalid,
    output wire        m_axi_bready,
    output wire [3:0]  m_axi_arid,
    output wire [15:0] m_axi_araddr,
    output wire [7:0]  m_axi_arlen,
    output wire [2:0]  m_axi_arsize,
    output wire [1:0]  m_axi_arburst,
    output wire [2:0]  m_axi_arprot,
    output wire        m_axi_arvalid,
    input  wire        m_axi_arready,
    input  wire [3:0]  m_axi_rid,
    input  wire [31:0] m_axi_rdata,
    input  wire [1:0]  m_axi_rresp,
    input  wire        m_axi_rlast,
    input  wire        m_axi_rvalid,
    output wire        m_axi_rready
);
    cm_axi_master_decoupler #(
        .AW_WIDTH(28), .DATA_WIDTH(32), .AR_WIDTH(36), .B_WIDTH(6), .R_WIDTH(38)
    ) dut (
        .clk(clk), .resetn(resetn), .decouple(decouple), .decoupled(decoupled),
        .s_awvalid(s_axi_awvalid), .s_awready(s_axi_awready),
        .s_awpayload({s_axi_awid, s_axi_awaddr, s_axi_awsize, s_axi_awburst, s_axi_awprot}), .s_awlen(s_axi_awlen),
        .s_wvalid(s_axi_wvalid), .s_wready(s_axi_wready), .s_wdata(s_axi_wdata), .s_wstrb(s_axi_wstrb),
        .s_bvalid(s_axi_bvalid), .s_bready(s_axi_bready), .s_bpayload({s_axi_bid, s_axi_bresp}),
        .s_arvalid(s_axi_arvalid), .s_arready(s_axi_arready),
        .s_arpayload({s_axi_arid, s_axi_araddr, s_axi_arlen, s_axi_arsize, s_axi_arburst, s_axi_arprot}),
        .s_rvalid(s_axi_rvalid), .s_rready(s_axi_rready), .s_rlast(s_axi_rlast),
        .s_rpayload({s_axi_rid, s_axi_rdata, s_axi_rresp}),
        .m_awvalid(m_axi_awvalid), .m_awready(m_axi_awready),
        .m_awpayload({m_axi_awid, m_axi_awaddr, m_axi_awsize, m_axi_awburst, m_axi_awprot}), .m_awlen(m_axi_awlen),
        .m_wvalid(m_axi_wvalid), .m_wready(m_axi_wready), .m_wdata(m_axi_wdata), .m_wstrb(m_axi_wstrb),
        .m_wlast(m_axi_wlast), .m_bvalid(m_axi_bvalid), .m_bready(m_axi_bready), .m_bpayload({m_axi_bid, m_axi_bresp}),
        .m_arvalid(m_axi_arvalid), .m_arready(m_axi_arready),
        .m_arpayload({m_axi_arid, m_axi_araddr, m_axi_arlen, m_axi_arsize, m_axi_arburst, m_axi_arprot}),
        .m_rvalid(m_axi_rvalid), .m_rready(m_axi_rready), .m_rlast(m_axi_rlast),
        .m_rpayload({m_axi_rid, m_axi_rdata, m_axi_rresp})
    );

    wire unused = &{1'b0, region_resetn, s_axi_wlast};
endmodule

`default_nettype wire
