// SPDX-License-Identifier: Apache-2.0
//
// Stands between an AXI4 (or AXI4-Lite) master inside a region and the static interconnect. When
// `decouple` rises nothing of the region is looked at any more, yet everything that it began is
// ended: the missing beats of a write burst are sent with all strobes low, responses and read
// data are taken and dropped. `decoupled` is high when the interconnect owes nothing.
//
// One write burst's data at a time; up to 255 unanswered writes and 255 reads.
`default_nettype none

module cm_axi_master_decoupler #(
    parameter AW_WIDTH   = 32,  // payload of AW beside AWLEN
    parameter DATA_WIDTH = 32,
    parameter AR_WIDTH   = 32,  // whole payload of AR
    parameter B_WIDTH    = 2,   // whole payload of B
    parameter R_WIDTH    = 34   // whole payload of R beside RLAST
) (
    input  wire                    clk,
    input  wire                    resetn,
    input  wire                    decouple,
    output wire                    decoupled,
    // from the region
    input  wire                    s_awvalid,
    output wire                    s_awready,
    input  wire [AW_WIDTH-1:0]     s_awpayload,
    input  wire [7:0]              s_awlen,
    input  wire                    s_wvalid,
    output wire                    s_wready,
    input  wire [DATA_WIDTH-1:0]   s_wdata,
    input  wire [DATA_WIDTH/8-1:0] s_wstrb,
    output wire                    s_bvalid,
    input  wire                    s_bready,
    output wire [B_WIDTH-1:0]      s_bpayload,
    input  wire                    s_arvalid,
    output wire                    s_arready,
    input  wire [AR_WIDTH-1:0]     s_arpayload,
    output wire                    s_rvalid,
    input  wire                    s_rready,
    output wire                    s_rlast,
    output wire [R_WIDTH-1:0]      s_rpayload,
    // to the static part
    output reg                     m_awvalid,
    input  wire                    m_awready,
    output reg  [AW_WIDTH-1:0]     m_awpayload,
    output reg  [7:0]              m_awlen,
    output reg                     m_wvalid,
    input  wire                    m_wready,
    output reg  [DATA_WIDTH-1:0]   m_wdata,
    output reg  [DATA_WIDTH/8-1:0] m_wstrb,
    output reg                     m_wlast,
    input  wire                    m_bvalid,
    output wire                    m_bready,
    input  wire [B_WIDTH-1:0]      m_bpayload,
    output reg                     m_arvalid,
    input  wire                    m_arready,
    output reg  [AR_WIDTH-1:0]     m_arpayload,
    input  wire                    m_rvalid,
    output wire                    m_rready,
    input  wire                    m_rlast,
    input  wire [R_WIDTH-1:0]      m_rpayload
);
    reg       w_busy;            // beats of the burst whose address was taken are missing
    reg [7:0] w_left;            // how many after the next one
    reg [7:0] writes, reads;     // not answered yet

    wire aw_take = s_awvalid && s_awready;
    wire w_room  = !m_wvalid || m_wready;
    wire w_take  = s_wvalid && s_wready;
    wire w_fill  = decouple && w_busy && w_room;
    wire b_take  = m_bvalid && m_bready;
    wire ar_take = s_arvalid && s_arready;
    wire r_end   = m_rvalid && m_rready && m_rlast;

    assign s_awready  = !decouple && (!m_awvalid || m_awready) && !w_busy && writes != 8'hFF;
    assign s_wready   = !decouple && w_busy && w_room;
    assign s_bvalid   = m_bvalid && !decouple;
    assign m_bready   = decouple || s_bready;
    assign s_bpayload = m_bpayload & {B_WIDTH{!decouple}};
    assign s_arready  = !decouple && (!m_arvalid || m_arready) && reads != 8'hFF;
    assign s_rvalid   = m_rvalid && !decouple;
    assign m_rready   = decouple || s_rready;
    assign s_rlast    = m_rlast && !decouple;
    assign s_rpayload = m_rpayload & {R_WIDTH{!decouple}};
    assign decoupled  = decouple && !m_awvalid && !m_wvalid && !w_busy && !m_arvalid && writes == 0 && reads == 0;

    always @(posedge clk) begin
        if (!resetn) begin
            m_awvalid   <= 1'b0;
            m_awpayload <= {AW_WIDTH{1'b0}};
            m_awlen     <= 8'd0;
            m_wvalid    <= 1'b0;
            m_wdata     <= {DATA_WIDTH{1'b0}};
            m_wstrb     <= {(DATA_WIDTH / 8) {1'b0}};
            m_wlast     <= 1'b0;
            m_arvalid   <= 1'b0;
            m_arpayload <= {AR_WIDTH{1'b0}};
            w_busy      <= 1'b0;
            w_left      <= 8'd0;
            writes      <= 8'd0;
            reads       <= 8'd0;
        end else begin
            if (!m_awvalid || m_awready) m_awvalid <= aw_take;
            if (aw_take) begin
                m_awpayload <= s_awpayload;
                m_awlen     <= s_awlen;
                w_busy      <= 1'b1;
                w_left      <= s_awlen;
            end
            if (w_room) m_wvalid <= w_take || w_fill;
            if (w_take || w_fill) begin
                m_wdata <= s_wdata & {DATA_WIDTH{w_take}};
                m_wstrb <= s_wstrb & {(DATA_WIDTH / 8) {w_take}};
                m_wlast <= w_left == 8'd0;
                w_left  <= w_left - 8'd1;
                w_busy  <= w_left != 8'd0;
            end
            if (!m_arvalid || m_arready) m_arvalid <= ar_take;
            if (ar_take) m_arpayload <= s_arpayload;
            writes <= writes + {7'd0, aw_take} - {7'd0, b_take};
            reads  <= reads + {7'd0, ar_take} - {7'd0, r_end};
        end
    end
endmodule

`default_nettype wire
