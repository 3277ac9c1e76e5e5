// SPDX-License-Identifier: Apache-2.0
//
// The processing system's cell as far as the open flow uses it: what a test drives as `gp_…` goes out of the master
// port for registers, and `hp_…` is the first port to memory, both with the signals that cocotbext-axi looks for.
`default_nettype none

module PS7 (
    output wire [ 3:0] FCLKCLK,
    output wire [ 3:0] FCLKRESETN,
    input  wire [19:0] IRQF2P,
    input  wire        MAXIGP0ACLK,
    input  wire        SAXIHP0ACLK,
    output wire [31:0] MAXIGP0AWADDR,
    output wire [11:0] MAXIGP0AWID,
    output wire        MAXIGP0AWVALID,
    output wire [31:0] MAXIGP0WDATA,
    output wire [ 3:0] MAXIGP0WSTRB,
    output wire        MAXIGP0WLAST,
    output wire        MAXIGP0WVALID,
    output wire        MAXIGP0BREADY,
    output wire [31:0] MAXIGP0ARADDR,
    output wire [11:0] MAXIGP0ARID,
    output wire [ 3:0] MAXIGP0ARLEN,
    output wire        MAXIGP0ARVALID,
    output wire        MAXIGP0RREADY,
    input  wire        MAXIGP0AWREADY,
    input  wire        MAXIGP0WREADY,
    input  wire [11:0] MAXIGP0BID,
    input  wire [ 1:0] MAXIGP0BRESP,
    input  wire        MAXIGP0BVALID,
    input  wire        MAXIGP0ARREADY,
    input  wire [31:0] MAXIGP0RDATA,
    input  wire [11:0] MAXIGP0RID,
    input  wire [ 1:0] MAXIGP0RRESP,
    input  wire        MAXIGP0RLAST,
    input  wire        MAXIGP0RVALID,
    input  wire [ 1:0] SAXIHP0ARBURST,
    input  wire [ 1:0] SAXIHP0ARSIZE,
    input  wire [ 3:0] SAXIHP0ARCACHE,
    input  wire [31:0] SAXIHP0ARADDR,
    input  wire [ 3:0] SAXIHP0ARLEN,
    input  wire        SAXIHP0ARVALID,
    input  wire        SAXIHP0RREADY,
    input  wire [ 1:0] SAXIHP0AWBURST,
    input  wire [ 1:0] SAXIHP0AWSIZE,
    input  wire [ 3:0] SAXIHP0AWCACHE,
    input  wire [31:0] SAXIHP0AWADDR,
    input  wire [ 3:0] SAXIHP0AWLEN,
    input  wire        SAXIHP0AWVALID,
    input  wire [63:0] SAXIHP0WDATA,
    input  wire [ 7:0] SAXIHP0WSTRB,
    input  wire        SAXIHP0WLAST,
    input  wire        SAXIHP0WVALID,
    input  wire        SAXIHP0BREADY,
    output wire        SAXIHP0ARREADY,
    output wire [63:0] SAXIHP0RDATA,
    output wire [ 1:0] SAXIHP0RRESP,
    output wire        SAXIHP0RLAST,
    output wire        SAXIHP0RVALID,
    output wire        SAXIHP0AWREADY,
    output wire        SAXIHP0WREADY,
    output wire [ 1:0] SAXIHP0BRESP,
    output wire        SAXIHP0BVALID
);
    reg clk = 1'b0;
    reg resetn;
    assign FCLKCLK = {3'd0, clk};
    assign FCLKRESETN = {3'd0, resetn};

    reg [31:0] gp_awaddr = 0;
    assign MAXIGP0AWADDR = gp_awaddr;
    reg [11:0] gp_awid = 0;
    assign MAXIGP0AWID = gp_awid;
    reg        gp_awvalid = 0;
    assign MAXIGP0AWVALID = gp_awvalid;
    reg [31:0] gp_wdata = 0;
    assign MAXIGP0WDATA = gp_wdata;
    reg [ 3:0] gp_wstrb = 0;
    assign MAXIGP0WSTRB = gp_wstrb;
    reg        gp_wlast = 0;
    assign MAXIGP0WLAST = gp_wlast;
    reg        gp_wvalid = 0;
    assign MAXIGP0WVALID = gp_wvalid;
    reg        gp_bready = 0;
    assign MAXIGP0BREADY = gp_bready;
    reg [31:0] gp_araddr = 0;
    assign MAXIGP0ARADDR = gp_araddr;
    reg [11:0] gp_arid = 0;
    assign MAXIGP0ARID = gp_arid;
    reg [ 7:0] gp_arlen = 0;
    assign MAXIGP0ARLEN = gp_arlen[3:0];
    reg        gp_arvalid = 0;
    assign MAXIGP0ARVALID = gp_arvalid;
    reg        gp_rready = 0;
    assign MAXIGP0RREADY = gp_rready;
    reg [ 7:0] gp_awlen = 0;
    reg [ 2:0] gp_awsize = 0, gp_arsize = 0;
    reg [ 1:0] gp_awburst = 0, gp_arburst = 0;
    wire        gp_awready = MAXIGP0AWREADY;
    wire        gp_wready = MAXIGP0WREADY;
    wire [11:0] gp_bid = MAXIGP0BID;
    wire [ 1:0] gp_bresp = MAXIGP0BRESP;
    wire        gp_bvalid = MAXIGP0BVALID;
    wire        gp_arready = MAXIGP0ARREADY;
    wire [31:0] gp_rdata = MAXIGP0RDATA;
    wire [11:0] gp_rid = MAXIGP0RID;
    wire [ 1:0] gp_rresp = MAXIGP0RRESP;
    wire        gp_rlast = MAXIGP0RLAST;
    wire        gp_rvalid = MAXIGP0RVALID;

    wire [ 1:0] hp_arburst = SAXIHP0ARBURST;
    wire [ 2:0] hp_arsize = {1'b0, SAXIHP0ARSIZE};
    wire [ 3:0] hp_arcache = SAXIHP0ARCACHE;
    wire [31:0] hp_araddr = SAXIHP0ARADDR;
    wire [ 7:0] hp_arlen = {4'd0, SAXIHP0ARLEN};
    wire        hp_arvalid = SAXIHP0ARVALID;
    wire        hp_rready = SAXIHP0RREADY;
    wire [ 1:0] hp_awburst = SAXIHP0AWBURST;
    wire [ 2:0] hp_awsize = {1'b0, SAXIHP0AWSIZE};
    wire [ 3:0] hp_awcache = SAXIHP0AWCACHE;
    wire [31:0] hp_awaddr = SAXIHP0AWADDR;
    wire [ 7:0] hp_awlen = {4'd0, SAXIHP0AWLEN};
    wire        hp_awvalid = SAXIHP0AWVALID;
    wire [63:0] hp_wdata = SAXIHP0WDATA;
    wire [ 7:0] hp_wstrb = SAXIHP0WSTRB;
    wire        hp_wlast = SAXIHP0WLAST;
    wire        hp_wvalid = SAXIHP0WVALID;
    wire        hp_bready = SAXIHP0BREADY;
    reg        hp_arready = 0;
    assign SAXIHP0ARREADY = hp_arready;
    reg [63:0] hp_rdata = 0;
    assign SAXIHP0RDATA = hp_rdata;
    reg [ 1:0] hp_rresp = 0;
    assign SAXIHP0RRESP = hp_rresp;
    reg        hp_rlast = 0;
    assign SAXIHP0RLAST = hp_rlast;
    reg        hp_rvalid = 0;
    assign SAXIHP0RVALID = hp_rvalid;
    reg        hp_awready = 0;
    assign SAXIHP0AWREADY = hp_awready;
    reg        hp_wready = 0;
    assign SAXIHP0WREADY = hp_wready;
    reg [ 1:0] hp_bresp = 0;
    assign SAXIHP0BRESP = hp_bresp;
    reg        hp_bvalid = 0;
    assign SAXIHP0BVALID = hp_bvalid;
    wire [ 5:0] hp_arid = 0, hp_awid = 0;
    reg [ 5:0] hp_rid = 0, hp_bid = 0;
endmodule

module BUFG (
    input  wire I,
    output wire O
);
    assign O = I;
endmodule

`default_nettype wire
