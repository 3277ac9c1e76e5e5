// SPDX-License-Identifier: Apache-2.0
//
// SOURCES AXI4-Streams to SINKS others, each sink from the source that its register names: registers and
// their meaning are those of Xilinx' AXI4-Stream Switch with control register routing (PG085):
//   0x000          CONTROL rw [1] REG_UPDATE: the routes below take effect; reads as 0 when they have
//   0x040 + 4 * n  MI_MUX  rw [3:0] the source of sink n, [31] none
// A source that several sinks name goes to the lowest of them; after reset no sink has one.
//
// Where PG085 resets the whole switch, only what changes is touched here: a sink whose source changes in
// the midst of a packet gets one beat more, with TLAST, as a region's that is cut off, and the rest of the packet of the
// source that went there is taken and dropped to its end. All other routes run on. A slice behind each
// source keeps TREADY from passing through: modules in a row would make one long path, in a ring a loop.
`default_nettype none

module cm_axis_switch #(
    parameter SOURCES = 2,  // 1 to 16
    parameter SINKS = 2,    // 1 to 16
    parameter BYTES = 4
) (
    input  wire                       clk,
    input  wire                       resetn,
    input  wire                       s_awvalid,
    output wire                       s_awready,
    input  wire [31:0]                s_awaddr,
    input  wire                       s_wvalid,
    output wire                       s_wready,
    input  wire [31:0]                s_wdata,
    input  wire [3:0]                 s_wstrb,
    output reg                        s_bvalid,
    input  wire                       s_bready,
    output wire [1:0]                 s_bresp,
    input  wire                       s_arvalid,
    output wire                       s_arready,
    input  wire [31:0]                s_araddr,
    output reg                        s_rvalid,
    input  wire                       s_rready,
    output wire [1:0]                 s_rresp,
    output reg  [31:0]                s_rdata,
    // source n in the bits from n * width on
    input  wire [SOURCES-1:0]         source_tvalid,
    output wire [SOURCES-1:0]         source_tready,
    input  wire [8*BYTES*SOURCES-1:0] source_tdata,
    input  wire [BYTES*SOURCES-1:0]   source_tkeep,
    input  wire [SOURCES-1:0]         source_tlast,
    output wire [SINKS-1:0]           sink_tvalid,
    input  wire [SINKS-1:0]           sink_tready,
    output wire [8*BYTES*SINKS-1:0]   sink_tdata,
    output wire [BYTES*SINKS-1:0]     sink_tkeep,
    output wire [SINKS-1:0]           sink_tlast
);
    localparam LANE = 9 * BYTES;  // TKEEP, then TDATA

    // -- registers
    reg  [5*SINKS-1:0] wanted;  // of each sink: none, then the source
    reg  [5*SINKS-1:0] routes;  // those in effect
    reg                update;

    wire write = s_awvalid && s_wvalid && !s_bvalid;
    wire read  = s_arvalid && !s_rvalid;
    wire [9:0] waddr = s_awaddr[11:2];
    wire [9:0] raddr = s_araddr[11:2];

    assign s_awready = write;
    assign s_wready  = write;
    assign s_arready = read;
    assign s_bresp   = 2'b00;
    assign s_rresp   = 2'b00;

    integer w;
    always @(posedge clk) begin
        if (!resetn) begin
            s_bvalid <= 1'b0;
            update   <= 1'b0;
            wanted   <= {SINKS{5'b10000}};
            routes   <= {SINKS{5'b10000}};
        end else begin
            if (write) s_bvalid <= 1'b1;
            else if (s_bready) s_bvalid <= 1'b0;
            update <= write && waddr == 10'h000 && s_wstrb[0] && s_wdata[1];
            if (update) routes <= wanted;
            for (w = 0; w < SINKS; w = w + 1)
                if (write && waddr == 10'h010 + w[9:0]) begin
                    if (s_wstrb[0]) wanted[5*w+:4] <= s_wdata[3:0];
                    if (s_wstrb[3]) wanted[5*w+4] <= s_wdata[31];
                end
        end
    end

    reg [31:0] value;
    integer r;
    always @* begin
        value = 32'd0;
        if (raddr == 10'h000) value[1] = update;
        for (r = 0; r < SINKS; r = r + 1)
            if (raddr == 10'h010 + r[9:0]) begin
                value[31]  = wanted[5*r+4];
                value[3:0] = wanted[5*r+:4];
            end
    end

    always @(posedge clk) begin
        if (!resetn) begin
            s_rvalid <= 1'b0;
            s_rdata  <= 32'd0;
        end else if (read) begin
            s_rvalid <= 1'b1;
            s_rdata  <= value;
        end else if (s_rready) s_rvalid <= 1'b0;
    end

    // -- who is connected: sink n to source m in effect, and after an update
    reg [SINKS*SOURCES-1:0] now, next;
    reg [SOURCES-1:0]       now_taken, next_taken;
    integer n, m;
    always @* begin
        now        = {SINKS*SOURCES{1'b0}};
        next       = {SINKS*SOURCES{1'b0}};
        now_taken  = {SOURCES{1'b0}};
        next_taken = {SOURCES{1'b0}};
        for (n = 0; n < SINKS; n = n + 1)
            for (m = 0; m < SOURCES; m = m + 1) begin
                if (routes[5*n+:5] == {1'b0, m[3:0]} && !now_taken[m]) begin
                    now[SOURCES*n+m] = 1'b1;
                    now_taken[m]     = 1'b1;
                end
                if (wanted[5*n+:5] == {1'b0, m[3:0]} && !next_taken[m]) begin
                    next[SOURCES*n+m] = 1'b1;
                    next_taken[m]     = 1'b1;
                end
            end
    end

    // -- what changes is cut off for a moment, as a region is that is loaded
    reg  [SINKS-1:0]   sink_cut;
    reg  [SOURCES-1:0] source_cut;
    wire [SINKS-1:0]   sink_quiet;
    wire [SOURCES-1:0] source_quiet;
    integer c, d;
    always @(posedge clk) begin
        if (!resetn) begin
            sink_cut   <= {SINKS{1'b0}};
            source_cut <= {SOURCES{1'b0}};
        end else begin
            sink_cut   <= sink_cut & ~sink_quiet;
            source_cut <= {SOURCES{1'b0}};
            if (update)
                for (c = 0; c < SINKS; c = c + 1)
                    for (d = 0; d < SOURCES; d = d + 1)
                        if (now[SOURCES*c+d] != next[SOURCES*c+d]) begin
                            sink_cut[c] <= 1'b1;
                            if (now[SOURCES*c+d]) source_cut[d] <= 1'b1;
                        end
        end
    end

    // -- sources, behind what drops the rest of a packet
    wire [SOURCES-1:0]      in_valid, in_last;
    wire [LANE*SOURCES-1:0] in_lane;
    reg  [SOURCES-1:0]      in_ready;
    wire [SINKS-1:0]        out_ready;
    genvar i;
    generate
        for (i = 0; i < SOURCES; i = i + 1) begin : source
            wire            valid, ready, last;
            wire [LANE-1:0] lane;
            cm_axis_slice #(.PAYLOAD_WIDTH(LANE + 1)) slice (
                .clk(clk), .resetn(resetn),
                .s_tvalid(source_tvalid[i]), .s_tready(source_tready[i]),
                .s_tpayload({source_tlast[i], source_tkeep[BYTES*i+:BYTES], source_tdata[8*BYTES*i+:8*BYTES]}),
                .m_tvalid(valid), .m_tready(ready), .m_tpayload({last, lane})
            );
            cm_axis_slave_decoupler #(.PAYLOAD_WIDTH(LANE), .HAS_LAST(1)) remainder (
                .clk(clk), .resetn(resetn), .decouple(source_cut[i]), .decoupled(source_quiet[i]),
                .s_tvalid(valid), .s_tready(ready), .s_tlast(last), .s_tpayload(lane),
                .m_tvalid(in_valid[i]), .m_tready(in_ready[i]), .m_tlast(in_last[i]),
                .m_tpayload(in_lane[LANE*i+:LANE])
            );
        end
    endgenerate

    integer a, b;
    always @* begin
        in_ready = {SOURCES{1'b0}};
        for (a = 0; a < SINKS; a = a + 1)
            for (b = 0; b < SOURCES; b = b + 1)
                if (now[SOURCES*a+b]) in_ready[b] = out_ready[a];
    end

    // -- sinks, before them what ends a packet that its source has left
    reg [SINKS-1:0]      out_valid, out_last;
    reg [LANE*SINKS-1:0] out_lane;
    integer e, f;
    always @* begin
        out_valid = {SINKS{1'b0}};
        out_last  = {SINKS{1'b0}};
        out_lane  = {LANE*SINKS{1'b0}};
        for (e = 0; e < SINKS; e = e + 1)
            for (f = 0; f < SOURCES; f = f + 1)
                if (now[SOURCES*e+f]) begin
                    out_valid[e]            = in_valid[f];
                    out_last[e]             = in_last[f];
                    out_lane[LANE*e+:LANE] = in_lane[LANE*f+:LANE];
                end
    end

    genvar k;
    generate
        for (k = 0; k < SINKS; k = k + 1) begin : sink
            cm_axis_master_decoupler #(
                .PAYLOAD_WIDTH(LANE), .CLOSING({{BYTES{1'b1}}, {8*BYTES{1'b0}}}), .HAS_LAST(1)
            ) ending (
                .clk(clk), .resetn(resetn), .decouple(sink_cut[k]), .decoupled(sink_quiet[k]),
                .s_tvalid(out_valid[k]), .s_tready(out_ready[k]), .s_tlast(out_last[k]),
                .s_tpayload(out_lane[LANE*k+:LANE]),
                .m_tvalid(sink_tvalid[k]), .m_tready(sink_tready[k]), .m_tlast(sink_tlast[k]),
                .m_tpayload({sink_tkeep[BYTES*k+:BYTES], sink_tdata[8*BYTES*k+:8*BYTES]})
            );
        end
    endgenerate

    wire unused = &{1'b0, s_awaddr[31:12], s_awaddr[1:0], s_araddr[31:12], s_araddr[1:0], s_wstrb[2:1],
                    s_wdata[30:4], source_quiet};
endmodule

`default_nettype wire
