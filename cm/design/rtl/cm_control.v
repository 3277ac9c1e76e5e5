// SPDX-License-Identifier: Apache-2.0
//
// Registers of the static part (AXI4-Lite, 4 KiB):
//   0x000 ID         ro   0x434D3031 ("CM01")
//   0x004 SHAPE      ro   [7:0] regions, [15:8] interrupt lines
//   0x008 IRQ_STATUS w1c  bit per interrupt line, 0 to 31
//   0x00C IRQ_ENABLE rw   bit per interrupt line, 0 to 31
//   0x010 IRQ_RAW    ro   bit per interrupt line, 0 to 31
//   0x014 ICAP       ro   [0] and [2] last load ended, [1] error: DONE and EOS where AXI HWICAP
//                         (PG134) has them, so that one driver reads either
//   0x018 ICAP_WORDS ro   words of the running or last load
//   0x01C STATIC_ID  ro   which static part this is: a hash of what it was generated from
//   0x020 + 0x10 * (k - 1)  the same three registers for lines 32 * k to 32 * k + 31, k from 1 to 3
// and for region n at 0x100 + 0x10 * n, so that a driver can own one region's register:
//   +0x0 DECOUPLE    rw   [0] cut the region off; is not cleared while the ICAP takes a load, whoever writes it: that
//                         page has to be user space's too, and a mapping knows no registers
//   +0x4 RESET       rw   [0] hold its module in reset
//   +0x8 STATUS      ro   [0] cut off, nothing pending on the static side;
//                         [1] it left an access unanswered and was cut off for that
//   +0xC IDENTITY    ro   what the module in it says it is; 0 while decoupled
`default_nettype none

module cm_control #(
    parameter REGIONS = 1,     // 1 to 32
    parameter IRQS = 1,        // 1 to 128
    parameter [IRQS-1:0] IRQ_EDGE = 0,
    parameter [31:0] STATIC_ID = 32'd0
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
    input  wire [2:0]            icap_status, // of cm_icap.v
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

    integer i, k, n;

    function [9:0] region_word(input [7:0] region, input [1:0] register);
        region_word = 10'h040 + {region, register};
    endfunction

    function [9:0] irq_word(input integer bank, input [1:0] register);
        irq_word = bank == 0 ? 10'h002 + {8'd0, register} : 10'h004 + {bank[7:0], 2'd0} + {8'd0, register};
    endfunction

    // interrupt lines in banks of 32, as the registers have them
    localparam integer BANKS = (IRQS + 31) / 32;
    localparam integer ALL = 32 * BANKS;
    reg  [IRQS-1:0] irq_enable;
    wire [IRQS-1:0] irq_raw, irq_status;
    reg  [ALL-1:0]  all_enable, all_raw, all_status, all_clear, next_enable;
    integer b;
    always @* begin
        all_enable = {ALL{1'b0}};
        all_raw    = {ALL{1'b0}};
        all_status = {ALL{1'b0}};
        all_enable[IRQS-1:0] = irq_enable;
        all_raw[IRQS-1:0]    = irq_raw;
        all_status[IRQS-1:0] = irq_status;
        all_clear   = {ALL{1'b0}};
        next_enable = all_enable;
        for (b = 0; b < BANKS; b = b + 1) begin
            if (write && waddr == irq_word(b, 2'd0)) all_clear[32*b+:32] = bits;
            if (write && waddr == irq_word(b, 2'd1))
                next_enable[32*b+:32] = (all_enable[32*b+:32] & ~lanes) | bits;
        end
    end

    assign s_awready = write;
    assign s_wready  = write;
    assign s_arready = read;
    assign s_bresp   = 2'b00;
    assign s_rresp   = 2'b00;

    cm_irq_concentrator #(.COUNT(IRQS), .EDGE(IRQ_EDGE)) concentrator (
        .clk(clk), .resetn(resetn), .lines(irq_lines), .enable(irq_enable), .clear(all_clear[IRQS-1:0]),
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
            irq_enable <= next_enable[IRQS-1:0];
            for (n = 0; n < REGIONS; n = n + 1) begin
                if (write && s_wstrb[0] && waddr == region_word(n[7:0], 2'd0))
                    decouple[n] <= s_wdata[0] || (decouple[n] && icap_status[2]);
                if (write && s_wstrb[0] && waddr == region_word(n[7:0], 2'd1)) region_reset[n] <= s_wdata[0];
            end
        end
    end

    reg [31:0] value;
    always @* begin
        value = 32'd0;
        case (raddr)
            10'h000: value = ID;
            10'h001: value = {16'd0, IRQS[7:0], REGIONS[7:0]};
            10'h005: value[2:0] = {icap_status[0], icap_status[1:0]};
            10'h006: value = icap_words;
            10'h007: value = STATIC_ID;
            default: begin
                for (k = 0; k < BANKS; k = k + 1) begin
                    if (raddr == irq_word(k, 2'd0)) value = all_status[32*k+:32];
                    if (raddr == irq_word(k, 2'd1)) value = all_enable[32*k+:32];
                    if (raddr == irq_word(k, 2'd2)) value = all_raw[32*k+:32];
                end
                for (i = 0; i < REGIONS; i = i + 1) begin
                    if (raddr == region_word(i[7:0], 2'd0)) value[0] = decouple[i];
                    if (raddr == region_word(i[7:0], 2'd1)) value[0] = region_reset[i];
                    if (raddr == region_word(i[7:0], 2'd2)) value[1:0] = {stuck[i], decoupled[i]};
                    if (raddr == region_word(i[7:0], 2'd3)) value = identity[i*32+:32];
                end
            end
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

    wire unused = &{1'b0, s_awaddr[31:12], s_awaddr[1:0], s_araddr[31:12], s_araddr[1:0], bits,
                    all_clear, next_enable};
endmodule

`default_nettype wire
