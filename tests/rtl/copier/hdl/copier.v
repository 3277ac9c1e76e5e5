// SPDX-License-Identifier: Apache-2.0
//
// A kernel with a master of its own: copies `words` words (a multiple of 4) from `source` to `target`, in bursts of
// four, with every bit inverted; raises its interrupt at the end. Registers:
//   0x00 start  wo   any write
//   0x04 source, 0x08 target, 0x0C words: rw
//   0x10 state  ro   [0] busy, [1] the bus answered with an error
`default_nettype none

module copier (
    input  wire        aclk,
    input  wire        aresetn,
    input  wire [7:0]  s_axi_awaddr,
    input  wire        s_axi_awvalid,
    output wire        s_axi_awready,
    input  wire [31:0] s_axi_wdata,
    input  wire [3:0]  s_axi_wstrb,
    input  wire        s_axi_wvalid,
    output wire        s_axi_wready,
    output wire [1:0]  s_axi_bresp,
    output reg         s_axi_bvalid,
    input  wire        s_axi_bready,
    input  wire [7:0]  s_axi_araddr,
    input  wire        s_axi_arvalid,
    output wire        s_axi_arready,
    output reg  [31:0] s_axi_rdata,
    output wire [1:0]  s_axi_rresp,
    output reg         s_axi_rvalid,
    input  wire        s_axi_rready,
    output wire [31:0] m_axi_araddr,
    output wire [7:0]  m_axi_arlen,
    output wire [2:0]  m_axi_arsize,
    output wire [1:0]  m_axi_arburst,
    output wire        m_axi_arvalid,
    input  wire        m_axi_arready,
    input  wire [31:0] m_axi_rdata,
    input  wire [1:0]  m_axi_rresp,
    input  wire        m_axi_rlast,
    input  wire        m_axi_rvalid,
    output wire        m_axi_rready,
    output wire [31:0] m_axi_awaddr,
    output wire [7:0]  m_axi_awlen,
    output wire [2:0]  m_axi_awsize,
    output wire [1:0]  m_axi_awburst,
    output wire        m_axi_awvalid,
    input  wire        m_axi_awready,
    output wire [31:0] m_axi_wdata,
    output wire [3:0]  m_axi_wstrb,
    output wire        m_axi_wlast,
    output wire        m_axi_wvalid,
    input  wire        m_axi_wready,
    input  wire [1:0]  m_axi_bresp,
    input  wire        m_axi_bvalid,
    output wire        m_axi_bready,
    (* X_INTERFACE_INFO = "xilinx.com:signal:interrupt:1.0 done INTERRUPT" *)
    output reg         done
);
    localparam [2:0] IDLE = 3'd0, ASK = 3'd1, READ = 3'd2, ADDRESS = 3'd3, WRITE = 3'd4, ANSWER = 3'd5;

    reg [2:0]  state;
    reg [31:0] source, target, words, left, from, to, word [0:3];
    reg [1:0]  beat;
    reg        failed;
    wire       write = s_axi_awvalid && s_axi_wvalid && !s_axi_bvalid;
    wire       read  = s_axi_arvalid && !s_axi_rvalid;

    assign s_axi_awready = write;
    assign s_axi_wready  = write;
    assign s_axi_arready = read;
    assign s_axi_bresp   = 2'b00;
    assign s_axi_rresp   = 2'b00;
    assign m_axi_araddr  = from;
    assign m_axi_arlen   = 8'd3;
    assign m_axi_arsize  = 3'd2;
    assign m_axi_arburst = 2'b01;
    assign m_axi_arvalid = state == ASK;
    assign m_axi_rready  = state == READ;
    assign m_axi_awaddr  = to;
    assign m_axi_awlen   = 8'd3;
    assign m_axi_awsize  = 3'd2;
    assign m_axi_awburst = 2'b01;
    assign m_axi_awvalid = state == ADDRESS;
    assign m_axi_wdata   = ~word[beat];
    assign m_axi_wstrb   = 4'hF;
    assign m_axi_wlast   = beat == 2'd3;
    assign m_axi_wvalid  = state == WRITE;
    assign m_axi_bready  = state == ANSWER;

    always @(posedge aclk) begin
        done <= 1'b0;
        if (!aresetn) begin
            state  <= IDLE;
            beat   <= 2'd0;
            failed <= 1'b0;
            left   <= 32'd0;
        end else case (state)
            IDLE: if (write && s_axi_awaddr[7:2] == 6'd0) begin
                {from, to, left} <= {source, target, words};
                failed           <= 1'b0;
                state            <= ASK;
            end
            ASK: if (m_axi_arready) state <= READ;
            READ: if (m_axi_rvalid) begin
                word[beat] <= m_axi_rdata;
                beat       <= beat + 2'd1;
                failed     <= failed || m_axi_rresp != 2'b00;
                if (m_axi_rlast) state <= ADDRESS;
            end
            ADDRESS: if (m_axi_awready) state <= WRITE;
            WRITE: if (m_axi_wready) begin
                beat <= beat + 2'd1;
                if (m_axi_wlast) state <= ANSWER;
            end
            default: if (m_axi_bvalid) begin
                failed <= failed || m_axi_bresp != 2'b00;
                from   <= from + 32'd16;
                to     <= to + 32'd16;
                left   <= left - 32'd4;
                done   <= left == 32'd4;
                state  <= left == 32'd4 ? IDLE : ASK;
            end
        endcase
    end

    always @(posedge aclk) begin
        if (!aresetn) begin
            s_axi_bvalid <= 1'b0;
            s_axi_rvalid <= 1'b0;
        end else begin
            s_axi_bvalid <= write || (s_axi_bvalid && !s_axi_bready);
            s_axi_rvalid <= read || (s_axi_rvalid && !s_axi_rready);
            if (write)
                case (s_axi_awaddr[7:2])
                    6'd1: source <= s_axi_wdata;
                    6'd2: target <= s_axi_wdata;
                    6'd3: words <= s_axi_wdata;
                    default: ;
                endcase
            if (read)
                case (s_axi_araddr[7:2])
                    6'd1: s_axi_rdata <= source;
                    6'd2: s_axi_rdata <= target;
                    6'd3: s_axi_rdata <= words;
                    default: s_axi_rdata <= {30'd0, failed, state != IDLE};
                endcase
        end
    end

    wire unused = &{1'b0, s_axi_wstrb, s_axi_awaddr[1:0], s_axi_araddr[1:0]};
endmodule

`default_nettype wire
