// SPDX-License-Identifier: Apache-2.0
//
// What holds of the DMA engine at every clock, whatever its surroundings do: yosys proves it by induction. With
// FAXIL its registers between ZipCPU's properties of an AXI4-Lite slave (wb2axip, bench/formal/faxil_slave.v), too.
module formal_axi_dma (
    input wire clk, input wire resetn,
    input wire [31:0] awaddr, wdata, araddr, input wire awvalid, wvalid, bready, arvalid, rready,
    input wire m_arready, input wire [63:0] m_rdata, input wire [1:0] m_rresp, input wire m_rlast, m_rvalid,
    input wire m_awready, m_wready, input wire [1:0] m_bresp, input wire m_bvalid,
    input wire tready, input wire [7:0] tdata, input wire tkeep, tlast, tvalid
);
    wire awready, wready, bvalid, arready, rvalid, m_arvalid, m_awvalid, m_wvalid, m_wlast, m_rready, m_bready;
    wire [1:0] bresp, rresp;
    wire [31:0] rdata, m_araddr, m_awaddr;
    wire [3:0] m_arlen, m_awlen;

    cm_axi_dma #(.LENGTH_BITS(8)) dut (
        .clk(clk), .resetn(resetn),
        .s_axi_awaddr(awaddr), .s_axi_awvalid(awvalid), .s_axi_awready(awready), .s_axi_wdata(wdata),
        .s_axi_wvalid(wvalid), .s_axi_wready(wready), .s_axi_bresp(bresp), .s_axi_bvalid(bvalid),
        .s_axi_bready(bready), .s_axi_araddr(araddr), .s_axi_arvalid(arvalid), .s_axi_arready(arready),
        .s_axi_rdata(rdata), .s_axi_rresp(rresp), .s_axi_rvalid(rvalid), .s_axi_rready(rready),
        .m_axi_araddr(m_araddr), .m_axi_arlen(m_arlen), .m_axi_arvalid(m_arvalid), .m_axi_arready(m_arready),
        .m_axi_rdata(m_rdata), .m_axi_rresp(m_rresp), .m_axi_rlast(m_rlast), .m_axi_rvalid(m_rvalid),
        .m_axi_rready(m_rready), .m_axi_awaddr(m_awaddr), .m_axi_awlen(m_awlen), .m_axi_awvalid(m_awvalid),
        .m_axi_awready(m_awready), .m_axi_wlast(m_wlast), .m_axi_wvalid(m_wvalid), .m_axi_wready(m_wready),
        .m_axi_bresp(m_bresp), .m_axi_bvalid(m_bvalid), .m_axi_bready(m_bready),
        .m_axis_tready(tready), .s_axis_tdata(tdata), .s_axis_tkeep(tkeep), .s_axis_tlast(tlast),
        .s_axis_tvalid(tvalid)
    );

    reg past = 1'b0;
    always @(posedge clk) past <= 1'b1;

    // To memory: what was offered stays until it is taken, through resets by register, halts and errors as well.
    always @(posedge clk)
        if (past && $past(resetn) && resetn) begin
            assert (m_rready && m_bready);
            if ($past(m_arvalid && !m_arready)) assert (m_arvalid && $stable(m_araddr) && $stable(m_arlen));
            if ($past(m_awvalid && !m_awready)) assert (m_awvalid && $stable(m_awaddr) && $stable(m_awlen));
            if ($past(m_wvalid && !m_wready)) assert (m_wvalid && $stable(m_wlast));
        end

`ifdef FAXIL
    wire [3:0] reads, writes, addresses;
    faxil_slave #(.C_AXI_ADDR_WIDTH(32), .F_OPT_INITIAL(1'b0)) properties (
        .i_clk(clk), .i_axi_reset_n(resetn),
        .i_axi_awvalid(awvalid), .i_axi_awready(awready), .i_axi_awaddr(awaddr), .i_axi_awprot(3'd0),
        .i_axi_wvalid(wvalid), .i_axi_wready(wready), .i_axi_wdata(wdata), .i_axi_wstrb(4'hf),
        .i_axi_bvalid(bvalid), .i_axi_bready(bready), .i_axi_bresp(bresp),
        .i_axi_arvalid(arvalid), .i_axi_arready(arready), .i_axi_araddr(araddr), .i_axi_arprot(3'd0),
        .i_axi_rvalid(rvalid), .i_axi_rready(rready), .i_axi_rdata(rdata), .i_axi_rresp(rresp),
        .f_axi_rd_outstanding(reads), .f_axi_wr_outstanding(writes), .f_axi_awr_outstanding(addresses)
    );
    always @(posedge clk) if (resetn) assert (reads == rvalid && writes == bvalid && addresses == bvalid);
`endif
endmodule
