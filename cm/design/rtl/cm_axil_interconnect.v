// SPDX-License-Identifier: Apache-2.0
//
// One AXI4-Lite master to COUNT slaves by address; an address outside every window is answered
// with DECERR, so that a wrong register map can never hang the processor. One write and one read
// at a time. BASE and MASK hold ADDR_WIDTH bits per slave, slave 0 in the lowest ones: slave i
// is meant when (address & MASK[i]) == BASE[i].
`default_nettype none

module cm_axil_interconnect #(
    parameter COUNT = 2,
    parameter ADDR_WIDTH = 32,
    parameter [COUNT*ADDR_WIDTH-1:0] BASE = 0,
    parameter [COUNT*ADDR_WIDTH-1:0] MASK = 0
) (
    input  wire                  clk,
    input  wire                  resetn,
    input  wire                  s_awvalid,
    output wire                  s_awready,
    input  wire [ADDR_WIDTH-1:0] s_awaddr,
    input  wire [2:0]            s_awprot,
    input  wire                  s_wvalid,
    output wire                  s_wready,
    input  wire [31:0]           s_wdata,
    input  wire [3:0]            s_wstrb,
    output wire                  s_bvalid,
    input  wire                  s_bready,
    output reg  [1:0]            s_bresp,
    input  wire                  s_arvalid,
    output wire                  s_arready,
    input  wire [ADDR_WIDTH-1:0] s_araddr,
    input  wire [2:0]            s_arprot,
    output wire                  s_rvalid,
    input  wire                  s_rready,
    output reg  [1:0]            s_rresp,
    output reg  [31:0]           s_rdata,
    // every slave's signals side by side; address, data and protection are shared
    output wire [COUNT-1:0]      m_awvalid,
    input  wire [COUNT-1:0]      m_awready,
    output reg  [ADDR_WIDTH-1:0] m_awaddr,
    output reg  [2:0]            m_awprot,
    output wire [COUNT-1:0]      m_wvalid,
    input  wire [COUNT-1:0]      m_wready,
    output reg  [31:0]           m_wdata,
    output reg  [3:0]            m_wstrb,
    input  wire [COUNT-1:0]      m_bvalid,
    output wire [COUNT-1:0]      m_bready,
    input  wire [COUNT*2-1:0]    m_bresp,
    output wire [COUNT-1:0]      m_arvalid,
    input  wire [COUNT-1:0]      m_arready,
    output reg  [ADDR_WIDTH-1:0] m_araddr,
    output reg  [2:0]            m_arprot,
    input  wire [COUNT-1:0]      m_rvalid,
    output wire [COUNT-1:0]      m_rready,
    input  wire [COUNT*2-1:0]    m_rresp,
    input  wire [COUNT*32-1:0]   m_rdata
);
    localparam [1:0] DECERR = 2'b11;
    localparam [1:0] IDLE = 2'd0, FORWARD = 2'd1, WAIT = 2'd2, ANSWER = 2'd3;

    reg [1:0]       w_state, r_state;
    reg [COUNT-1:0] w_select, r_select;   // one hot, or none
    reg             aw_pending, w_pending;
    reg             aw_held, w_held;      // taken from the master, not yet both

    integer i;
    reg [COUNT-1:0] w_match, r_match;
    reg [1:0]       b_resp, r_resp;
    reg [31:0]      r_data;

    always @* begin
        w_match = {COUNT{1'b0}};
        r_match = {COUNT{1'b0}};
        b_resp  = 2'b00;
        r_resp  = 2'b00;
        r_data  = 32'd0;
        for (i = 0; i < COUNT; i = i + 1) begin
            w_match[i] = (m_awaddr & MASK[i*ADDR_WIDTH+:ADDR_WIDTH]) == BASE[i*ADDR_WIDTH+:ADDR_WIDTH];
            r_match[i] = (s_araddr & MASK[i*ADDR_WIDTH+:ADDR_WIDTH]) == BASE[i*ADDR_WIDTH+:ADDR_WIDTH];
            b_resp     = b_resp | (m_bresp[i*2+:2] & {2{w_select[i]}});
            r_resp     = r_resp | (m_rresp[i*2+:2] & {2{r_select[i]}});
            r_data     = r_data | (m_rdata[i*32+:32] & {32{r_select[i]}});
        end
    end

    assign s_awready = w_state == IDLE && !aw_held;
    assign s_wready  = w_state == IDLE && !w_held;
    assign s_bvalid  = w_state == ANSWER;
    assign s_arready = r_state == IDLE;
    assign s_rvalid  = r_state == ANSWER;
    assign m_awvalid = w_select & {COUNT{w_state == FORWARD && aw_pending}};
    assign m_wvalid  = w_select & {COUNT{w_state == FORWARD && w_pending}};
    assign m_bready  = w_select & {COUNT{w_state == WAIT}};
    assign m_arvalid = r_select & {COUNT{r_state == FORWARD}};
    assign m_rready  = r_select & {COUNT{r_state == WAIT}};

    always @(posedge clk) begin
        if (!resetn) begin
            w_state    <= IDLE;
            w_select   <= {COUNT{1'b0}};
            aw_pending <= 1'b0;
            w_pending  <= 1'b0;
            aw_held    <= 1'b0;
            w_held     <= 1'b0;
            m_awaddr   <= {ADDR_WIDTH{1'b0}};
            m_awprot   <= 3'd0;
            m_wdata    <= 32'd0;
            m_wstrb    <= 4'd0;
            s_bresp    <= 2'b00;
        end else begin
            if (s_awvalid && s_awready) begin
                aw_held  <= 1'b1;
                m_awaddr <= s_awaddr;
                m_awprot <= s_awprot;
            end
            if (s_wvalid && s_wready) begin
                w_held  <= 1'b1;
                m_wdata <= s_wdata;
                m_wstrb <= s_wstrb;
            end
            case (w_state)
                IDLE: if (aw_held && w_held) begin
                    w_select   <= w_match;
                    aw_pending <= 1'b1;
                    w_pending  <= 1'b1;
                    s_bresp    <= DECERR;
                    w_state    <= |w_match ? FORWARD : ANSWER;
                end
                FORWARD: begin
                    if (|(m_awvalid & m_awready)) aw_pending <= 1'b0;
                    if (|(m_wvalid & m_wready)) w_pending <= 1'b0;
                    if ((!aw_pending || |(m_awvalid & m_awready)) && (!w_pending || |(m_wvalid & m_wready)))
                        w_state <= WAIT;
                end
                WAIT: if (|(m_bvalid & m_bready)) begin
                    s_bresp <= b_resp;
                    w_state <= ANSWER;
                end
                default: if (s_bready) begin
                    w_state <= IDLE;
                    aw_held <= 1'b0;
                    w_held  <= 1'b0;
                end
            endcase
        end
    end

    always @(posedge clk) begin
        if (!resetn) begin
            r_state  <= IDLE;
            r_select <= {COUNT{1'b0}};
            m_araddr <= {ADDR_WIDTH{1'b0}};
            m_arprot <= 3'd0;
            s_rresp  <= 2'b00;
            s_rdata  <= 32'd0;
        end else begin
            case (r_state)
                IDLE: if (s_arvalid) begin
                    m_araddr <= s_araddr;
                    m_arprot <= s_arprot;
                    r_select <= r_match;
                    s_rresp  <= DECERR;
                    s_rdata  <= 32'd0;
                    r_state  <= |r_match ? FORWARD : ANSWER;
                end
                FORWARD: if (|(m_arvalid & m_arready)) r_state <= WAIT;
                WAIT: if (|(m_rvalid & m_rready)) begin
                    s_rresp <= r_resp;
                    s_rdata <= r_data;
                    r_state <= ANSWER;
                end
                default: if (s_rready) r_state <= IDLE;
            endcase
        end
    end
endmodule

`default_nettype wire
