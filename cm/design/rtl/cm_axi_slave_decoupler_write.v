// SPDX-License-Identifier: Apache-2.0
//
// Write half of cm_axi_slave_decoupler: takes one burst at a time and answers it, by the
// region's response or, where the region is cut off, by SLVERR. The address is offered in the
// clock of the first beat: there are slaves that take both at once, or nothing.
`default_nettype none

module cm_axi_slave_decoupler_write #(
    parameter AW_WIDTH = 32,
    parameter W_WIDTH  = 36,
    parameter ID_WIDTH = 1,
    parameter TIMEOUT  = 65535,
    parameter GRACE    = 255
) (
    input  wire                clk,
    input  wire                resetn,
    input  wire                decouple,
    input  wire                blocked,
    output wire                active,   // the region holds an access
    output wire                expired,  // it was given up now, without a decoupling
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
    output reg  [1:0]          s_bresp,
    output wire [ID_WIDTH-1:0] s_bid,
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
    input  wire [1:0]          m_bresp
);
    localparam [1:0] SLVERR = 2'b10;
    localparam [2:0] IDLE = 3'd0, RUN = 3'd1, WAIT = 3'd2, DROP = 3'd3, ANSWER = 3'd4;

    reg [2:0]          state;
    reg [AW_WIDTH-1:0] address;
    reg [7:0]          length;
    reg [ID_WIDTH-1:0] id;
    reg                address_pending, offered;
    reg                beat_valid, beat_last, last_seen;
    reg [W_WIDTH-1:0]  beat;
    reg [31:0]         timer;

    wire room     = !beat_valid || m_wready;
    wire take     = s_wvalid && s_wready;
    wire progress = (m_awvalid && m_awready) || (m_wvalid && m_wready) || take;
    wire limit    = decouple ? (timer >= GRACE) : (timer >= TIMEOUT);
    // time runs while the region owes something, not while the master owes data
    wire owed     = m_awvalid || m_wvalid || state == WAIT;
    wire answered = state == WAIT && m_bvalid;
    wire give_up  = active && owed && limit && !answered;
    // an access cut by decoupling while its master owes data is not waited for
    wire cut_idle = active && decouple && !owed && limit;

    assign active      = state == RUN || state == WAIT;
    assign expired     = give_up && !decouple;
    assign s_awready   = state == IDLE;
    assign s_wready    = (state == RUN && room && !last_seen) || (state == DROP && !last_seen);
    assign s_bvalid    = state == ANSWER;
    assign s_bid       = id;
    assign m_awvalid   = state == RUN && address_pending && (beat_valid || offered);
    assign m_awpayload = address;
    assign m_awlen     = length;
    assign m_awid      = id;
    assign m_wvalid    = state == RUN && beat_valid;
    assign m_wlast     = beat_last;
    assign m_wpayload  = beat;
    assign m_bready    = state == WAIT;

    always @(posedge clk) begin
        if (!resetn) begin
            state           <= IDLE;
            address         <= {AW_WIDTH{1'b0}};
            length          <= 8'd0;
            id              <= {ID_WIDTH{1'b0}};
            address_pending <= 1'b0;
            offered         <= 1'b0;
            beat_valid      <= 1'b0;
            beat_last       <= 1'b0;
            last_seen       <= 1'b0;
            beat            <= {W_WIDTH{1'b0}};
            timer           <= 32'd0;
            s_bresp         <= 2'b00;
        end else begin
            timer <= (!active || (progress && !decouple)) ? 32'd0 : timer + 32'd1;
            if (m_awvalid && m_awready) address_pending <= 1'b0;
            if (m_awvalid) offered <= 1'b1;
            if (state == RUN && room) beat_valid <= take;
            if (take) begin
                beat      <= s_wpayload;
                beat_last <= s_wlast;
                last_seen <= s_wlast;
            end
            case (state)
                IDLE: if (s_awvalid) begin
                    address         <= s_awpayload;
                    length          <= s_awlen;
                    id              <= s_awid;
                    address_pending <= !blocked;
                    offered         <= 1'b0;
                    beat_valid      <= 1'b0;
                    last_seen       <= 1'b0;
                    s_bresp         <= SLVERR;
                    state           <= blocked ? DROP : RUN;
                end
                RUN: begin
                    if (give_up || cut_idle) state <= DROP;
                    else if (last_seen && !(beat_valid && !m_wready) && !(address_pending && !(m_awvalid && m_awready)))
                        state <= WAIT;
                end
                WAIT: begin
                    if (answered) begin
                        s_bresp <= m_bresp;
                        state   <= ANSWER;
                    end else if (give_up) state <= ANSWER;
                end
                DROP: if (last_seen || (take && s_wlast)) state <= ANSWER;
                ANSWER: if (s_bready) state <= IDLE;
                default: state <= IDLE;
            endcase
        end
    end
endmodule

`default_nettype wire
