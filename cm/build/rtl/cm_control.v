// SPDX-License-Identifier: Apache-2.0
//
// Registers of the static part (AXI4-Lite, 4 KiB):
//   0x00 ID         ro   0x434D3031 ("CM01")
//   0x04 SHAPE      ro   [7:0] regions, [15:8] interrupt lines
//   0x08 DECOUPLE   rw   bit per region: cut it off
//   0x0C DECOUPLED  ro   bit per region: cut off, nothing pending on the static side
//   0x10 RESET      rw   bit per region: hold its module in reset
//   0x14 IRQ_STATUS w1c  bit per interrupt line
//   0x18 IRQ_ENABLE rw   bit per interrupt line
//   0x1C IRQ_RAW    ro   bit per interrupt line
//   0x20 STUCK      ro   bit per region: it left an access unanswered and was cut off
//   0x24 ICAP       ro   [0] last load ended, [1] error
//   0x28 ICAP_WORDS ro   words of the running or last load
//   0x40 + 4*n IDENTITY  ro  what the module in region n says it is; 0 while decoupled
`default_nettype none

module cm_control #(
    parameter REGIONS = 1,     // 1 to 32
    parameter IRQS = 1,        // 1 to 32
    parameter [IRQS-1:0] IRQ_EDGE = 0
) (
    input  wire                  clk,
    input  wire                  resetn,
    input  wire                  s_awvalid,
    output wire                  s_awready,
    input  wire [31:0]           s_awaddr,
    input  wire                  s_wvalid,
    output wire                  s_wready,
    input  wire [31:0]           s_wdata,
    input  wire [3:0]            s_wstrb,
    output reg                   s_bvalid,
    input  wire                  s_bready,
    output wire [1:0]            s_bresp,
    input  wire                  s_arvalid,
    output wire                  s_arready,
    input  wire [31:0]           s_araddr,
    output reg                   s_rvalid,
    input  wire                  s_rready,
    output wire [1:0]            s_rresp,
    output reg  [31:0]           s_rdata,
    output reg  [REGIONS-1:0]    decouple,
    output reg  [REGIONS-1:0]    region_reset,
    input  wire [REGIONS-1:0]    decoupled,
    input  wire [REGIONS-1:0]    stuck,
    input  wire [REGIONS*32-1:0] identity,
    input  wire [1:0]            icap_status,
    input  wire [31:0]           icap_words,
    input  wire [IRQS-1:0]       irq_lines,
    output wire                  irq
);
    localparam [31:0] ID = 32'h434D3031;

    wire write = s_awvalid && s_wvalid && !s_bvalid;
    wire read  = s_arvalid && !s_rvalid;
    wire [31:0] lanes = {{8{s_wstrb[3]}}, {8{s_wstrb[2]}}, {8{s_wstrb[1]}}, {8{s_wstrb[0]}}};
    wire [31:0] bits = s_wdata & lanes;
    wire [9:0] waddr = s_awaddr[11:2];
    wire [9:0] raddr = s_araddr[11:2];

    reg  [IRQS-1:0] irq_enable;
    wire [IRQS-1:0] irq_raw, irq_status;
    wire [IRQS-1:0] irq_clear = bits[IRQS-1:0] & {IRQS{write && waddr == 10'h005}};

    assign s_awready = write;
    assign s_wready  = write;
    assign s_arready = read;
    assign s_bresp   = 2'b00;
    assign s_rresp   = 2'b00;

    cm_irq_concentrator #(.COUNT(IRQS), .EDGE(IRQ_EDGE)) concentrator (
        .clk(clk), .resetn(resetn), .lines(irq_lines), .enable(irq_enable), .clear(irq_clear),
        .raw(irq_raw), .status(irq_status), .irq(irq)
    );

    always @(posedge clk) begin
        if (!resetn) begin
            s_bvalid     <= 1'b0;
            decouple     <= {REGIONS{1'b0}};
            region_reset <= {REGIONS{1'b0}};
            irq_enable   <= {IRQS{1'b0}};
        end else begin
            if (write) s_bvalid <= 1'b1;
            else if (s_bready) s_bvalid <= 1'b0;
            if (write && waddr == 10'h002)
                decouple <= (decouple & ~lanes[REGIONS-1:0]) | bits[REGIONS-1:0];
            if (write && waddr == 10'h004)
                region_reset <= (region_reset & ~lanes[REGIONS-1:0]) | bits[REGIONS-1:0];
            if (write && waddr == 10'h006)
                irq_enable <= (irq_enable & ~lanes[IRQS-1:0]) | bits[IRQS-1:0];
        end
    end

    // every readable register in one padded vector per kind keeps widths plain
    reg [31:0] value;
    integer i;
    always @* begin
        value = 32'd0;
        case (raddr)
            10'h000: value = ID;
            10'h001: value = {16'd0, IRQS[7:0], REGIONS[7:0]};
            10'h002: value[REGIONS-1:0] = decouple;
            10'h003: value[REGIONS-1:0] = decoupled;
            10'h004: value[REGIONS-1:0] = region_reset;
            10'h005: value[IRQS-1:0] = irq_status;
            10'h006: value[IRQS-1:0] = irq_enable;
            10'h007: value[IRQS-1:0] = irq_raw;
            10'h008: value[REGIONS-1:0] = stuck;
            10'h009: value[1:0] = icap_status;
            10'h00A: value = icap_words;
            default:
                for (i = 0; i < REGIONS; i = i + 1)
                    if (raddr == 10'h010 + i[9:0]) value = identity[i*32+:32];
        endcase
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

    wire unused = &{1'b0, s_awaddr[31:12], s_awaddr[1:0], s_araddr[31:12], s_araddr[1:0], bits};
endmodule

`default_nettype wire
