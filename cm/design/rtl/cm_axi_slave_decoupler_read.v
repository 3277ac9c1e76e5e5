// SPDX-License-Identifier: Apache-2.0
//
// Read half of cm_axi_slave_decoupler: hands one burst to the region and, where the region does
// not answer or is cut off, supplies the beats that are missing with SLVERR.
`default_nettype none

module cm_axi_slave_decoupler_read #(
    parameter AR_WIDTH = 32,
    parameter R_WIDTH  = 32,
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
    input  wire                s_arvalid,
    output wire                s_arready,
    input  wire [AR_WIDTH-1:0] s_arpayload,
    input  wire [7:0]          s_arlen,
    input  wire [ID_WIDTH-1:0] s_arid,
    output reg                 s_rvalid,
    input  wire                s_rready,
    output reg  [1:0]          s_rresp,
    output reg                 s_rlast,
    output reg  [R_WIDTH-1:0]  s_rpayload,
    output wire [ID_WIDTH-1:0] s_rid,
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
    localparam [1:0] SLVERR = 2'b10;
    localparam [1:0] IDLE = 2'd0, RUN = 2'd1, FAIL = 2'd2, LAST = 2'd3;

    reg [1:0]          state;
    reg [AR_WIDTH-1:0] address;
    reg [7:0]          length, left;
    reg [ID_WIDTH-1:0] id;
    reg                address_pending;
    reg [31:0]         timer;

    wire room     = !s_rvalid || s_rready;
    wire take     = m_rvalid && m_rready;
    wire progress = (m_arvalid && m_arready) || take;
    wire limit    = decouple ? (timer >= GRACE) : (timer >= TIMEOUT);
    wire give_up  = active && limit && !take;

    assign active      = state == RUN;
    assign expired     = give_up && !decouple;
    assign s_arready   = state == IDLE;
    assign s_rid       = id;
    assign m_arvalid   = state == RUN && address_pending;
    assign m_arpayload = address;
    assign m_arlen     = length;
    assign m_arid      = id;
    assign m_rready    = state == RUN && !address_pending && room;

    always @(posedge clk) begin
        if (!resetn) begin
            state           <= IDLE;
            address         <= {AR_WIDTH{1'b0}};
            length          <= 8'd0;
            left            <= 8'd0;
            id              <= {ID_WIDTH{1'b0}};
            address_pending <= 1'b0;
            timer           <= 32'd0;
            s_rvalid        <= 1'b0;
            s_rresp         <= 2'b00;
            s_rlast         <= 1'b0;
            s_rpayload      <= {R_WIDTH{1'b0}};
        end else begin
            // a master that does not take what the region gave is no fault of the region
            if (!active || (progress && !decouple)) timer <= 32'd0;
            else if (room || decouple) timer <= timer + 32'd1;
            if (m_arvalid && m_arready) address_pending <= 1'b0;
            if (room) s_rvalid <= take || state == FAIL;
            if (take) begin
                s_rpayload <= m_rpayload;
                s_rresp    <= m_rresp;
            end else if (state == FAIL && room) begin
                s_rpayload <= {R_WIDTH{1'b0}};
                s_rresp    <= SLVERR;
            end
            if (take || (state == FAIL && room)) begin
                s_rlast <= left == 8'd0;
                left    <= left - 8'd1;
            end
            case (state)
                IDLE: if (s_arvalid) begin
                    address         <= s_arpayload;
                    length          <= s_arlen;
                    left            <= s_arlen;
                    id              <= s_arid;
                    address_pending <= !blocked;
                    state           <= blocked ? FAIL : RUN;
                end
                RUN: begin
                    if (take && left == 8'd0) state <= LAST;
                    else if (give_up) state <= FAIL;
                end
                FAIL: if (room && left == 8'd0) state <= LAST;
                LAST: if (s_rready) state <= IDLE;
                default: state <= IDLE;
            endcase
        end
    end
endmodule

`default_nettype wire
