// SPDX-License-Identifier: Apache-2.0
//
// A DMA engine with the registers of AXI DMA (PG021) in direct register mode, so that whatever drives that one
// drives this one: MM2S at 0x00, S2MM at 0x30 (cm_dma_channel.v), no scatter/gather, no realignment. To memory it is
// an AXI3 master with one identifier, which is a subset of AXI4: words of DATA_BYTES, rising addresses, bursts of at
// most 16. A reset is one of both directions, as PG021's; it reads as 1 until all bursts have ended. What the stream
// has been offered and has not taken is withdrawn by a reset, by RS = 0 and after an error.
`default_nettype none

module cm_axi_dma #(
    parameter HAS_MM2S = 1,
    parameter HAS_S2MM = 1,
    parameter LENGTH_BITS = 23,  // 8 to 26
    parameter DATA_BYTES = 8,    // of memory: 4 or 8
    parameter MM2S_BYTES = 1,    // of a beat: 1, 2, 4 or 8, not more than DATA_BYTES
    parameter S2MM_BYTES = 1,
    parameter S2MM_LAST = 1      // 0: the stream has no TLAST, a transfer ends when the buffer is full
) (
    input  wire                    clk,
    input  wire                    resetn,
    input  wire [            31:0] s_axi_awaddr,
    input  wire                    s_axi_awvalid,
    output wire                    s_axi_awready,
    input  wire [            31:0] s_axi_wdata,
    input  wire                    s_axi_wvalid,
    output wire                    s_axi_wready,
    output wire [             1:0] s_axi_bresp,
    output reg                     s_axi_bvalid,
    input  wire                    s_axi_bready,
    input  wire [            31:0] s_axi_araddr,
    input  wire                    s_axi_arvalid,
    output wire                    s_axi_arready,
    output reg  [            31:0] s_axi_rdata,
    output wire [             1:0] s_axi_rresp,
    output reg                     s_axi_rvalid,
    input  wire                    s_axi_rready,
    output wire                    mm2s_introut,
    output wire                    s2mm_introut,
    output wire [            31:0] m_axi_araddr,
    output wire [             3:0] m_axi_arlen,
    output wire                    m_axi_arvalid,
    input  wire                    m_axi_arready,
    input  wire [8*DATA_BYTES-1:0] m_axi_rdata,
    input  wire [             1:0] m_axi_rresp,
    input  wire                    m_axi_rlast,
    input  wire                    m_axi_rvalid,
    output wire                    m_axi_rready,
    output wire [            31:0] m_axi_awaddr,
    output wire [             3:0] m_axi_awlen,
    output wire                    m_axi_awvalid,
    input  wire                    m_axi_awready,
    output wire [8*DATA_BYTES-1:0] m_axi_wdata,
    output wire [  DATA_BYTES-1:0] m_axi_wstrb,
    output wire                    m_axi_wlast,
    output wire                    m_axi_wvalid,
    input  wire                    m_axi_wready,
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
    localparam [7:0] S2MM = 8'h0C, END = 8'h18;  // words

    // Registers: an answer in the clock behind the request
    wire write = s_axi_awvalid && s_axi_wvalid && !s_axi_bvalid;
    wire read = s_axi_arvalid && !s_axi_rvalid;
    wire [7:0] waddr = s_axi_awaddr[9:2];
    wire [7:0] raddr = s_axi_araddr[9:2];
    wire [3:0] waddr_s2mm = waddr[3:0] - S2MM[3:0];
    wire [3:0] raddr_s2mm = raddr[3:0] - S2MM[3:0];
    wire [31:0] rdata_mm2s, rdata_s2mm;

    assign s_axi_awready = write;
    assign s_axi_wready  = write;
    assign s_axi_arready = read;
    assign s_axi_bresp   = 2'b00;
    assign s_axi_rresp   = 2'b00;

    always @(posedge clk)
        if (!resetn) begin
            s_axi_bvalid <= 1'b0;
            s_axi_rvalid <= 1'b0;
        end else begin
            s_axi_bvalid <= write || (s_axi_bvalid && !s_axi_bready);
            s_axi_rvalid <= read || (s_axi_rvalid && !s_axi_rready);
            if (read) s_axi_rdata <= raddr < S2MM ? rdata_mm2s : raddr < END ? rdata_s2mm : 32'd0;
        end

    reg resetting;
    wire reset_mm2s, reset_s2mm, quiet_mm2s, quiet_s2mm;

    always @(posedge clk)
        if (!resetn) resetting <= 1'b0;
        else resetting <= reset_mm2s || reset_s2mm || (resetting && !(quiet_mm2s && quiet_s2mm));

    generate
        if (HAS_MM2S != 0) begin : mm2s
            wire start, stop, done, slave_error, decode_error;
            wire [31:0] address;
            wire [LENGTH_BITS-1:0] length;

            cm_dma_channel #(
                .LENGTH_BITS(LENGTH_BITS),
                .STREAM_BYTES(MM2S_BYTES)
            ) channel (
                .clk(clk), .resetn(resetn), .resetting(resetting), .reset(reset_mm2s),
                .write(write && waddr < S2MM), .waddr(waddr[3:0]), .wdata(s_axi_wdata),
                .raddr(raddr[3:0]), .rdata(rdata_mm2s), .interrupt(mm2s_introut),
                .start(start), .address(address), .length(length), .stop(stop), .quiet(quiet_mm2s), .done(done),
                .left({LENGTH_BITS{1'b0}}), .internal_error(1'b0), .slave_error(slave_error),
                .decode_error(decode_error)
            );

            cm_dma_reader #(
                .LENGTH_BITS(LENGTH_BITS),
                .DATA_BYTES(DATA_BYTES),
                .STREAM_BYTES(MM2S_BYTES)
            ) reader (
                .clk(clk), .resetn(resetn), .start(start), .address(address), .length(length), .stop(stop),
                .quiet(quiet_mm2s), .done(done), .slave_error(slave_error), .decode_error(decode_error),
                .m_axi_araddr(m_axi_araddr), .m_axi_arlen(m_axi_arlen), .m_axi_arvalid(m_axi_arvalid),
                .m_axi_arready(m_axi_arready), .m_axi_rdata(m_axi_rdata), .m_axi_rresp(m_axi_rresp),
                .m_axi_rlast(m_axi_rlast), .m_axi_rvalid(m_axi_rvalid), .m_axi_rready(m_axi_rready),
                .m_axis_tdata(m_axis_tdata), .m_axis_tkeep(m_axis_tkeep), .m_axis_tlast(m_axis_tlast),
                .m_axis_tvalid(m_axis_tvalid), .m_axis_tready(m_axis_tready)
            );
        end else begin : no_mm2s
            assign {reset_mm2s, quiet_mm2s, rdata_mm2s, mm2s_introut} = {2'b01, 32'd0, 1'b0};
            assign {m_axi_araddr, m_axi_arlen, m_axi_arvalid, m_axi_rready} = 38'd0;
            assign {m_axis_tdata, m_axis_tkeep, m_axis_tlast, m_axis_tvalid} = {9 * MM2S_BYTES + 2{1'b0}};
            wire unused = &{1'b0, m_axi_arready, m_axi_rdata, m_axi_rresp, m_axi_rlast, m_axi_rvalid, m_axis_tready};
        end

        if (HAS_S2MM != 0) begin : s2mm
            wire start, stop, done, internal_error, slave_error, decode_error;
            wire [31:0] address;
            wire [LENGTH_BITS-1:0] length, left;

            cm_dma_channel #(
                .LENGTH_BITS(LENGTH_BITS),
                .STREAM_BYTES(S2MM_BYTES),
                .RECEIVES(1)
            ) channel (
                .clk(clk), .resetn(resetn), .resetting(resetting), .reset(reset_s2mm),
                .write(write && waddr >= S2MM && waddr < END), .waddr(waddr_s2mm), .wdata(s_axi_wdata),
                .raddr(raddr_s2mm), .rdata(rdata_s2mm), .interrupt(s2mm_introut),
                .start(start), .address(address), .length(length), .stop(stop), .quiet(quiet_s2mm), .done(done),
                .left(left), .internal_error(internal_error), .slave_error(slave_error), .decode_error(decode_error)
            );

            cm_dma_writer #(
                .LENGTH_BITS(LENGTH_BITS),
                .DATA_BYTES(DATA_BYTES),
                .STREAM_BYTES(S2MM_BYTES),
                .HAS_LAST(S2MM_LAST)
            ) writer (
                .clk(clk), .resetn(resetn), .start(start), .address(address), .length(length), .stop(stop),
                .quiet(quiet_s2mm), .done(done), .left(left), .internal_error(internal_error),
                .slave_error(slave_error), .decode_error(decode_error),
                .m_axi_awaddr(m_axi_awaddr), .m_axi_awlen(m_axi_awlen), .m_axi_awvalid(m_axi_awvalid),
                .m_axi_awready(m_axi_awready), .m_axi_wdata(m_axi_wdata), .m_axi_wstrb(m_axi_wstrb),
                .m_axi_wlast(m_axi_wlast), .m_axi_wvalid(m_axi_wvalid), .m_axi_wready(m_axi_wready),
                .m_axi_bresp(m_axi_bresp), .m_axi_bvalid(m_axi_bvalid), .m_axi_bready(m_axi_bready),
                .s_axis_tdata(s_axis_tdata), .s_axis_tkeep(s_axis_tkeep), .s_axis_tlast(s_axis_tlast),
                .s_axis_tvalid(s_axis_tvalid), .s_axis_tready(s_axis_tready)
            );
        end else begin : no_s2mm
            assign {reset_s2mm, quiet_s2mm, rdata_s2mm, s2mm_introut, s_axis_tready} = {2'b01, 32'd0, 2'b00};
            assign {m_axi_awaddr, m_axi_awlen, m_axi_awvalid, m_axi_bready} = 38'd0;
            assign {m_axi_wdata, m_axi_wstrb, m_axi_wlast, m_axi_wvalid} = {9 * DATA_BYTES + 2{1'b0}};
            wire unused = &{1'b0, m_axi_awready, m_axi_wready, m_axi_bresp, m_axi_bvalid, s_axis_tdata, s_axis_tkeep,
                            s_axis_tlast, s_axis_tvalid, waddr_s2mm, raddr_s2mm};
        end
    endgenerate

    wire unused = &{1'b0, s_axi_awaddr, s_axi_araddr};
endmodule

`default_nettype wire
