// SPDX-License-Identifier: Apache-2.0
//
// The DMA engine with the names that cocotbext-axi looks for, an AXI memory's sidebands at what the processing
// system's ports are given, and answers that a test can make errors of.
`default_nettype none

module tb_axi_dma #(
    parameter HAS_MM2S = 1,
    parameter HAS_S2MM = 1,
    parameter LENGTH_BITS = 23,
    parameter DATA_BYTES = 8,
    parameter MM2S_BYTES = 1,
    parameter S2MM_BYTES = 1,
    parameter S2MM_LAST = 1
) (
    input  wire                    clk,
    input  wire                    resetn,
    input  wire                    stream_resetn,  // of what stands at the streams
    input  wire [             1:0] bad_read,   // in place of OKAY
    input  wire [             1:0] bad_write,
    output wire                    mm2s_introut,
    output wire                    s2mm_introut,
    input  wire [            31:0] s_axi_awaddr,
    input  wire                    s_axi_awvalid,
    output wire                    s_axi_awready,
    input  wire [            31:0] s_axi_wdata,
    input  wire                    s_axi_wvalid,
    output wire                    s_axi_wready,
    output wire [             1:0] s_axi_bresp,
    output wire                    s_axi_bvalid,
    input  wire                    s_axi_bready,
    input  wire [            31:0] s_axi_araddr,
    input  wire                    s_axi_arvalid,
    output wire                    s_axi_arready,
    output wire [            31:0] s_axi_rdata,
    output wire [             1:0] s_axi_rresp,
    output wire                    s_axi_rvalid,
    input  wire                    s_axi_rready,
    output wire [             3:0] m_axi_arid,
    output wire [            31:0] m_axi_araddr,
    output wire [             7:0] m_axi_arlen,
    output wire [             2:0] m_axi_arsize,
    output wire [             1:0] m_axi_arburst,
    output wire                    m_axi_arvalid,
    input  wire                    m_axi_arready,
    input  wire [             3:0] m_axi_rid,
    input  wire [8*DATA_BYTES-1:0] m_axi_rdata,
    input  wire [             1:0] m_axi_rresp,
    input  wire                    m_axi_rlast,
    input  wire                    m_axi_rvalid,
    output wire                    m_axi_rready,
    output wire [             3:0] m_axi_awid,
    output wire [            31:0] m_axi_awaddr,
    output wire [             7:0] m_axi_awlen,
    output wire [             2:0] m_axi_awsize,
    output wire [             1:0] m_axi_awburst,
    output wire                    m_axi_awvalid,
    input  wire                    m_axi_awready,
    output wire [8*DATA_BYTES-1:0] m_axi_wdata,
    output wire [  DATA_BYTES-1:0] m_axi_wstrb,
    output wire                    m_axi_wlast,
    output wire                    m_axi_wvalid,
    input  wire                    m_axi_wready,
    input  wire [             3:0] m_axi_bid,
    input  wire [             1:0] m_axi_bresp,
    input  wire                    m_axi_bvalid,
    output wire                    m_axi_bready,
    output wire [8*MM2S_BYTES-1:0] m_axis_tdata,
    output wire [  MM2S_BYTES-1:0] m_axis_tkeep,
    output wire                    m_axis_tlast,
    output wire                    m_axis_tvalid,
    input  wire                    m_axis_tready,
    input  wire [8*S2MM_BYTES-1:0] s_axis_tdata,
    input  wire [  S2MM_BYTES-1:0] s_axis_tkeep,
    input  wire                    s_axis_tlast,
    input  wire                    s_axis_tvalid,
    output wire                    s_axis_tready
);
    assign {m_axi_arid, m_axi_awid} = 8'd0;
    assign m_axi_arsize  = DATA_BYTES == 8 ? 3'd3 : 3'd2;
    assign m_axi_awsize  = m_axi_arsize;
    assign m_axi_arburst = 2'b01;
    assign m_axi_awburst = 2'b01;
    assign m_axi_arlen[7:4] = 4'd0;
    assign m_axi_awlen[7:4] = 4'd0;

    cm_axi_dma #(
        .HAS_MM2S(HAS_MM2S), .HAS_S2MM(HAS_S2MM), .LENGTH_BITS(LENGTH_BITS), .DATA_BYTES(DATA_BYTES),
        .MM2S_BYTES(MM2S_BYTES), .S2MM_BYTES(S2MM_BYTES), .S2MM_LAST(S2MM_LAST)
    ) dma (
        .clk(clk), .resetn(resetn), .mm2s_introut(mm2s_introut), .s2mm_introut(s2mm_introut),
        .s_axi_awaddr(s_axi_awaddr), .s_axi_awvalid(s_axi_awvalid), .s_axi_awready(s_axi_awready),
        .s_axi_wdata(s_axi_wdata), .s_axi_wvalid(s_axi_wvalid), .s_axi_wready(s_axi_wready),
        .s_axi_bresp(s_axi_bresp), .s_axi_bvalid(s_axi_bvalid), .s_axi_bready(s_axi_bready),
        .s_axi_araddr(s_axi_araddr), .s_axi_arvalid(s_axi_arvalid), .s_axi_arready(s_axi_arready),
        .s_axi_rdata(s_axi_rdata), .s_axi_rresp(s_axi_rresp), .s_axi_rvalid(s_axi_rvalid),
        .s_axi_rready(s_axi_rready),
        .m_axi_araddr(m_axi_araddr), .m_axi_arlen(m_axi_arlen[3:0]), .m_axi_arvalid(m_axi_arvalid),
        .m_axi_arready(m_axi_arready), .m_axi_rdata(m_axi_rdata), .m_axi_rresp(m_axi_rresp | bad_read),
        .m_axi_rlast(m_axi_rlast), .m_axi_rvalid(m_axi_rvalid), .m_axi_rready(m_axi_rready),
        .m_axi_awaddr(m_axi_awaddr), .m_axi_awlen(m_axi_awlen[3:0]), .m_axi_awvalid(m_axi_awvalid),
        .m_axi_awready(m_axi_awready), .m_axi_wdata(m_axi_wdata), .m_axi_wstrb(m_axi_wstrb),
        .m_axi_wlast(m_axi_wlast), .m_axi_wvalid(m_axi_wvalid), .m_axi_wready(m_axi_wready),
        .m_axi_bresp(m_axi_bresp | bad_write), .m_axi_bvalid(m_axi_bvalid), .m_axi_bready(m_axi_bready),
        .m_axis_tdata(m_axis_tdata), .m_axis_tkeep(m_axis_tkeep), .m_axis_tlast(m_axis_tlast),
        .m_axis_tvalid(m_axis_tvalid), .m_axis_tready(m_axis_tready),
        .s_axis_tdata(s_axis_tdata), .s_axis_tkeep(s_axis_tkeep), .s_axis_tlast(s_axis_tlast),
        .s_axis_tvalid(s_axis_tvalid), .s_axis_tready(s_axis_tready)
    );
endmodule

`default_nettype wire
