// SPDX-License-Identifier: Apache-2.0
//
// A general-purpose master port of the processing system (AXI3) to AXI4-Lite: one access at a time, bursts
// word by word at rising addresses, the worst answer of a write burst for the whole.
`default_nettype none

module cm_gp_lite (
    input  wire        clk,
    input  wire        resetn,
    input  wire [31:0] s_awaddr,
    input  wire [11:0] s_awid,
    input  wire        s_awvalid,
    output wire        s_awready,
    input  wire [31:0] s_wdata,
    input  wire [ 3:0] s_wstrb,
    input  wire        s_wlast,
    input  wire        s_wvalid,
    output wire        s_wready,
    output reg  [11:0] s_bid,
    output reg  [ 1:0] s_bresp,
    output wire        s_bvalid,
    input  wire        s_bready,
    input  wire [31:0] s_araddr,
    input  wire [11:0] s_arid,
    input  wire [ 3:0] s_arlen,
    input  wire        s_arvalid,
    output wire        s_arready,
    output reg  [31:0] s_rdata,
    output reg  [11:0] s_rid,
    output reg  [ 1:0] s_rresp,
    output wire        s_rlast,
    output wire        s_rvalid,
    input  wire        s_rready,
    output reg  [31:0] m_awaddr,
    output wire [ 2:0] m_awprot,
    output reg         m_awvalid,
    input  wire        m_awready,
    output reg  [31:0] m_wdata,
    output reg  [ 3:0] m_wstrb,
    output reg         m_wvalid,
    input  wire        m_wready,
    input  wire [ 1:0] m_bresp,
    input  wire        m_bvalid,
    output wire        m_bready,
    output reg  [31:0] m_araddr,
    output wire [ 2:0] m_arprot,
    output reg         m_arvalid,
    input  wire        m_arready,
    input  wire [31:0] m_rdata,
    input  wire [ 1:0] m_rresp,
    input  wire        m_rvalid,
    output wire        m_rready
);
    localparam IDLE = 2'd0, BEAT = 2'd1, ANSWER = 2'd2, LAST = 2'd3;

    reg [1:0] writing = IDLE;
    reg       ended = 1'b0;

    assign m_awprot = 3'b000;
    assign m_arprot = 3'b000;

    // Writes: IDLE takes the address, BEAT a word, ANSWER waits for the slave, LAST gives the answer back.
    assign s_awready = writing == IDLE;
    assign s_wready = writing == BEAT;
    assign m_bready = writing == ANSWER;
    assign s_bvalid = writing == LAST;

    always @(posedge clk) begin
        if (!resetn) begin
            writing   <= IDLE;
            m_awvalid <= 1'b0;
            m_wvalid  <= 1'b0;
        end else begin
            if (m_awvalid && m_awready) m_awvalid <= 1'b0;
            if (m_wvalid && m_wready) m_wvalid <= 1'b0;
            case (writing)
                IDLE:
                if (s_awvalid) begin
                    m_awaddr <= s_awaddr;
                    s_bid    <= s_awid;
                    s_bresp  <= 2'b00;
                    writing  <= BEAT;
                end
                BEAT:
                if (s_wvalid) begin
                    m_wdata   <= s_wdata;
                    m_wstrb   <= s_wstrb;
                    ended     <= s_wlast;
                    m_awvalid <= 1'b1;
                    m_wvalid  <= 1'b1;
                    writing   <= ANSWER;
                end
                ANSWER:
                if (m_bvalid) begin
                    if (m_bresp > s_bresp) s_bresp <= m_bresp;
                    m_awaddr <= m_awaddr + 32'd4;
                    writing  <= ended ? LAST : BEAT;
                end
                LAST: if (s_bready) writing <= IDLE;
            endcase
        end
    end

    // Reads: IDLE takes the address, BEAT asks, ANSWER waits for the slave, LAST gives the word back.
    reg [1:0] reading = IDLE;
    reg [3:0] left = 4'd0;

    assign s_arready = reading == IDLE;
    assign m_rready = reading == ANSWER;
    assign s_rvalid = reading == LAST;
    assign s_rlast = left == 4'd0;

    always @(posedge clk) begin
        if (!resetn) begin
            reading   <= IDLE;
            m_arvalid <= 1'b0;
        end else begin
            if (m_arvalid && m_arready) m_arvalid <= 1'b0;
            case (reading)
                IDLE:
                if (s_arvalid) begin
                    m_araddr <= s_araddr;
                    s_rid    <= s_arid;
                    left     <= s_arlen;
                    reading  <= BEAT;
                end
                BEAT: begin
                    m_arvalid <= 1'b1;
                    reading   <= ANSWER;
                end
                ANSWER:
                if (m_rvalid) begin
                    s_rdata <= m_rdata;
                    s_rresp <= m_rresp;
                    reading <= LAST;
                end
                LAST:
                if (s_rready) begin
                    left     <= left - 4'd1;
                    m_araddr <= m_araddr + 32'd4;
                    reading  <= s_rlast ? IDLE : BEAT;
                end
            endcase
        end
    end
endmodule

`default_nettype wire
