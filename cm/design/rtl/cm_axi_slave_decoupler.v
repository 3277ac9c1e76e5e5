// SPDX-License-Identifier: Apache-2.0
//
// Stands between a static AXI4 or AXI4-Lite master and a slave inside a region. Whatever the
// region does, every access of the master is answered:
//   - while `decouple` is high, accesses are answered with SLVERR and never reach the region;
//   - an access under way when `decouple` rises has GRACE cycles to end, then SLVERR;
//   - a region that leaves an access without progress for TIMEOUT cycles is `stuck`: it is
//     cut off, and every access is answered with SLVERR, until `clear` (its reset).
//
// One write and one read at a time. AXI4-Lite: tie s_awlen, s_arlen and ids to 0, s_wlast to 1.
// Address and the other attributes travel in the payloads. INCR, FIXED and WRAP bursts alike.
`default_nettype none

module cm_axi_slave_decoupler #(
    parameter AW_WIDTH = 32,  // payload of AW beside AWLEN and AWID
    parameter W_WIDTH  = 36,  // payload of W beside WLAST
    parameter AR_WIDTH = 32,
    parameter R_WIDTH  = 32,  // payload of R beside RRESP, RLAST, RID
    parameter ID_WIDTH = 1,
    parameter TIMEOUT  = 65535,
    parameter GRACE    = 255
) (
    input  wire                clk,
    input  wire                resetn,
    input  wire                decouple,
    input  wire                clear,
    output wire                decoupled,
    output reg                 stuck,
    // static side
    input  wire                s_awvalid,
    output wire                s_awready,
    input  wire [AW_WIDTH-1:0] s_awpayload,
    input  wire [7:0]          s_awlen,
    input  wire [ID_WIDTH-1:0] s_awid,
    input  wire                s_wvalid,
    output wire                s_wready,
    input  wire                s_wlast,
    input  wire [W_WIDTH-1:0]  s_wpayload,
    output wire                s_bvalid,
    input  wire                s_bready,
    output wire [1:0]          s_bresp,
    output wire [ID_WIDTH-1:0] s_bid,
    input  wire                s_arvalid,
    output wire                s_arready,
    input  wire [AR_WIDTH-1:0] s_arpayload,
    input  wire [7:0]          s_arlen,
    input  wire [ID_WIDTH-1:0] s_arid,
    output wire                s_rvalid,
    input  wire                s_rready,
    output wire [1:0]          s_rresp,
    output wire                s_rlast,
    output wire [R_WIDTH-1:0]  s_rpayload,
    output wire [ID_WIDTH-1:0] s_rid,
    // region side
    output wire                m_awvalid,
    input  wire                m_awready,
    output wire [AW_WIDTH-1:0] m_awpayload,
    output wire [7:0]          m_awlen,
    output wire [ID_WIDTH-1:0] m_awid,
    output wire                m_wvalid,
    input  wire                m_wready,
    output wire                m_wlast,
    output wire [W_WIDTH-1:0]  m_wpayload,
    input  wire                m_bvalid,
    output wire                m_bready,
    input  wire [1:0]          m_bresp,
    output wire                m_arvalid,
    input  wire                m_arready,
    output wire [AR_WIDTH-1:0] m_arpayload,
    output wire [7:0]          m_arlen,
    output wire [ID_WIDTH-1:0] m_arid,
    input  wire                m_rvalid,
    output wire                m_rready,
    input  wire [1:0]          m_rresp,
    input  wire [R_WIDTH-1:0]  m_rpayload
);
    wire write_expired, read_expired, write_active, read_active;

    cm_axi_slave_decoupler_write #(
        .AW_WIDTH(AW_WIDTH), .W_WIDTH(W_WIDTH), .ID_WIDTH(ID_WIDTH), .TIMEOUT(TIMEOUT), .GRACE(GRACE)
    ) write_side (
        .clk(clk), .resetn(resetn), .decouple(decouple), .blocked(decouple || stuck),
        .active(write_active), .expired(write_expired),
        .s_awvalid(s_awvalid), .s_awready(s_awready), .s_awpayload(s_awpayload), .s_awlen(s_awlen), .s_awid(s_awid),
        .s_wvalid(s_wvalid), .s_wready(s_wready), .s_wlast(s_wlast), .s_wpayload(s_wpayload),
        .s_bvalid(s_bvalid), .s_bready(s_bready), .s_bresp(s_bresp), .s_bid(s_bid),
        .m_awvalid(m_awvalid), .m_awready(m_awready), .m_awpayload(m_awpayload), .m_awlen(m_awlen), .m_awid(m_awid),
        .m_wvalid(m_wvalid), .m_wready(m_wready), .m_wlast(m_wlast), .m_wpayload(m_wpayload),
        .m_bvalid(m_bvalid), .m_bready(m_bready), .m_bresp(m_bresp)
    );

    cm_axi_slave_decoupler_read #(
        .AR_WIDTH(AR_WIDTH), .R_WIDTH(R_WIDTH), .ID_WIDTH(ID_WIDTH), .TIMEOUT(TIMEOUT), .GRACE(GRACE)
    ) read_side (
        .clk(clk), .resetn(resetn), .decouple(decouple), .blocked(decouple || stuck),
        .active(read_active), .expired(read_expired),
        .s_arvalid(s_arvalid), .s_arready(s_arready), .s_arpayload(s_arpayload), .s_arlen(s_arlen), .s_arid(s_arid),
        .s_rvalid(s_rvalid), .s_rready(s_rready), .s_rresp(s_rresp), .s_rlast(s_rlast), .s_rpayload(s_rpayload),
        .s_rid(s_rid),
        .m_arvalid(m_arvalid), .m_arready(m_arready), .m_arpayload(m_arpayload), .m_arlen(m_arlen), .m_arid(m_arid),
        .m_rvalid(m_rvalid), .m_rready(m_rready), .m_rresp(m_rresp), .m_rpayload(m_rpayload)
    );

    assign decoupled = decouple && !write_active && !read_active;

    always @(posedge clk) begin
        if (!resetn || clear) stuck <= 1'b0;
        else if (write_expired || read_expired) stuck <= 1'b1;
    end
endmodule

`default_nettype wire
