// SPDX-License-Identifier: Apache-2.0
//
// What stands in for the block design where no vendor tool is: the processing system of a Zynq-7000 with one
// clock, its reset, one master port as AXI4-Lite and one interrupt. Pins of the memory and of MIO are the
// processing system's own and need no wire here.
`default_nettype none

module cm_open_system (
    output wire        clk,
    output wire        resetn,
    output wire [31:0] m_axi_awaddr,
    output wire [ 2:0] m_axi_awprot,
    output wire        m_axi_awvalid,
    input  wire        m_axi_awready,
    output wire [31:0] m_axi_wdata,
    output wire [ 3:0] m_axi_wstrb,
    output wire        m_axi_wvalid,
    input  wire        m_axi_wready,
    input  wire [ 1:0] m_axi_bresp,
    input  wire        m_axi_bvalid,
    output wire        m_axi_bready,
    output wire [31:0] m_axi_araddr,
    output wire [ 2:0] m_axi_arprot,
    output wire        m_axi_arvalid,
    input  wire        m_axi_arready,
    input  wire [31:0] m_axi_rdata,
    input  wire [ 1:0] m_axi_rresp,
    input  wire        m_axi_rvalid,
    output wire        m_axi_rready,
    input  wire        irq
);
    wire [ 3:0] fclk;
    wire [ 3:0] fresetn;
    wire [31:0] awaddr, wdata, araddr, rdata;
    wire [11:0] awid, bid, arid, rid;
    wire [3:0] wstrb, arlen;
    wire [1:0] bresp, rresp;
    wire awvalid, awready, wlast, wvalid, wready, bvalid, bready;
    wire arvalid, arready, rlast, rvalid, rready;

    (* keep *)
    PS7 ps7 (
        .FCLKCLK(fclk),
        .FCLKRESETN(fresetn),
        .IRQF2P({19'd0, irq}),
        .MAXIGP0ACLK(clk),
        .MAXIGP0AWADDR(awaddr),
        .MAXIGP0AWID(awid),
        .MAXIGP0AWVALID(awvalid),
        .MAXIGP0AWREADY(awready),
        .MAXIGP0WDATA(wdata),
        .MAXIGP0WSTRB(wstrb),
        .MAXIGP0WLAST(wlast),
        .MAXIGP0WVALID(wvalid),
        .MAXIGP0WREADY(wready),
        .MAXIGP0BID(bid),
        .MAXIGP0BRESP(bresp),
        .MAXIGP0BVALID(bvalid),
        .MAXIGP0BREADY(bready),
        .MAXIGP0ARADDR(araddr),
        .MAXIGP0ARID(arid),
        .MAXIGP0ARLEN(arlen),
        .MAXIGP0ARVALID(arvalid),
        .MAXIGP0ARREADY(arready),
        .MAXIGP0RDATA(rdata),
        .MAXIGP0RID(rid),
        .MAXIGP0RRESP(rresp),
        .MAXIGP0RLAST(rlast),
        .MAXIGP0RVALID(rvalid),
        .MAXIGP0RREADY(rready)
    );

    (* keep *)
    BUFG cm_clock_buffer (
        .I(fclk[0]),
        .O(clk)
    );

    // The reset of the fabric falls at any time and rises with the clock.
    cm_sync #(
        .WIDTH(1)
    ) sync_reset (
        .clk(clk),
        .d(fresetn[0]),
        .q(resetn)
    );

    cm_gp_lite bridge (
        .clk(clk),
        .resetn(resetn),
        .s_awaddr(awaddr),
        .s_awid(awid),
        .s_awvalid(awvalid),
        .s_awready(awready),
        .s_wdata(wdata),
        .s_wstrb(wstrb),
        .s_wlast(wlast),
        .s_wvalid(wvalid),
        .s_wready(wready),
        .s_bid(bid),
        .s_bresp(bresp),
        .s_bvalid(bvalid),
        .s_bready(bready),
        .s_araddr(araddr),
        .s_arid(arid),
        .s_arlen(arlen),
        .s_arvalid(arvalid),
        .s_arready(arready),
        .s_rdata(rdata),
        .s_rid(rid),
        .s_rresp(rresp),
        .s_rlast(rlast),
        .s_rvalid(rvalid),
        .s_rready(rready),
        .m_awaddr(m_axi_awaddr),
        .m_awprot(m_axi_awprot),
        .m_awvalid(m_axi_awvalid),
        .m_awready(m_axi_awready),
        .m_wdata(m_axi_wdata),
        .m_wstrb(m_axi_wstrb),
        .m_wvalid(m_axi_wvalid),
        .m_wready(m_axi_wready),
        .m_bresp(m_axi_bresp),
        .m_bvalid(m_axi_bvalid),
        .m_bready(m_axi_bready),
        .m_araddr(m_axi_araddr),
        .m_arprot(m_axi_arprot),
        .m_arvalid(m_axi_arvalid),
        .m_arready(m_axi_arready),
        .m_rdata(m_axi_rdata),
        .m_rresp(m_axi_rresp),
        .m_rvalid(m_axi_rvalid),
        .m_rready(m_axi_rready)
    );
endmodule

`default_nettype wire
