// SPDX-License-Identifier: Apache-2.0
// Registers as Vivado HLS lays them out: ap_ctrl at 0x00, interrupts from 0x04 on, arguments from 0x10 on.
`timescale 1ns/1ps
module tone_control_s_axi #(
    parameter C_S_AXI_ADDR_WIDTH = 5,
    parameter C_S_AXI_DATA_WIDTH = 32
) (
    input  wire                            ACLK,
    input  wire                            ARESET,
    input  wire [C_S_AXI_ADDR_WIDTH-1:0]   AWADDR,
    input  wire                            AWVALID,
    output wire                            AWREADY,
    input  wire [C_S_AXI_DATA_WIDTH-1:0]   WDATA,
    input  wire [C_S_AXI_DATA_WIDTH/8-1:0] WSTRB,
    input  wire                            WVALID,
    output wire                            WREADY,
    output wire [1:0]                      BRESP,
    output wire                            BVALID,
    input  wire                            BREADY,
    input  wire [C_S_AXI_ADDR_WIDTH-1:0]   ARADDR,
    input  wire                            ARVALID,
    output wire                            ARREADY,
    output wire [C_S_AXI_DATA_WIDTH-1:0]   RDATA,
    output wire [1:0]                      RRESP,
    output wire                            RVALID,
    input  wire                            RREADY,
    output wire                            interrupt,
    output wire                            ap_start,
    input  wire                            ap_done,
    input  wire                            ap_ready,
    input  wire                            ap_idle,
    output wire [15:0]                     rows,
    output wire [15:0]                     cols
);
//------------------------Address Info-------------------
// 0x00 : Control signals
//        bit 0  - ap_start (Read/Write/COH)
//        bit 1  - ap_done (Read/COR)
//        bit 2  - ap_idle (Read)
//        bit 3  - ap_ready (Read)
//        bit 7  - auto_restart (Read/Write)
//        others - reserved
// 0x04 : Global Interrupt Enable Register
//        bit 0  - Global Interrupt Enable (Read/Write)
//        others - reserved
// 0x08 : IP Interrupt Enable Register (Read/Write)
//        bit 0  - Channel 0 (ap_done)
//        others - reserved
// 0x0c : IP Interrupt Status Register (Read/TOW)
//        bit 0  - Channel 0 (ap_done)
//        others - reserved
// 0x10 : Data signal of rows
//        bit 15~0 - rows[15:0] (Read/Write)
//        others   - reserved
// 0x14 : reserved
// 0x18 : Data signal of cols
//        bit 15~0 - cols[15:0] (Read/Write)
//        others   - reserved
// 0x1c : reserved
// (SC = Self Clear, COR = Clear on Read, TOW = Toggle on Write, COH = Clear on Handshake)
localparam
    ADDR_AP_CTRL     = 5'h00,
    ADDR_GIE         = 5'h04,
    ADDR_IER         = 5'h08,
    ADDR_ISR         = 5'h0c,
    ADDR_ROWS_DATA_0 = 5'h10,
    ADDR_COLS_DATA_0 = 5'h18;

reg                          taken = 1'b0, answered = 1'b0, valid = 1'b0;
reg [C_S_AXI_ADDR_WIDTH-1:0] waddr;
reg [31:0]                   rdata;
reg                          int_ap_done = 1'b0, int_ap_start = 1'b0, int_auto_restart = 1'b0;
reg                          int_gie = 1'b0, int_ier = 1'b0, int_isr = 1'b0;
reg [15:0]                   int_rows = 'b0, int_cols = 'b0;

assign AWREADY   = !taken && !answered;
assign WREADY    = taken;
assign BRESP     = 2'b00;
assign BVALID    = answered;
assign ARREADY   = !valid;
assign RDATA     = rdata;
assign RRESP     = 2'b00;
assign RVALID    = valid;
assign interrupt = int_gie & int_isr;
assign ap_start  = int_ap_start;
assign rows      = int_rows;
assign cols      = int_cols;

wire write = WVALID && WREADY;
wire read  = ARVALID && ARREADY;

always @(posedge ACLK) begin
    if (ARESET) begin
        taken <= 1'b0;
        answered <= 1'b0;
        valid <= 1'b0;
        int_ap_done <= 1'b0;
        int_ap_start <= 1'b0;
        int_auto_restart <= 1'b0;
        int_gie <= 1'b0;
        int_ier <= 1'b0;
        int_isr <= 1'b0;
        int_rows <= 'b0;
        int_cols <= 'b0;
    end else begin
        if (AWVALID && AWREADY) begin
            taken <= 1'b1;
            waddr <= AWADDR;
        end else if (write) begin
            taken <= 1'b0;
            answered <= 1'b1;
        end
        if (BVALID && BREADY)
            answered <= 1'b0;
        if (read) begin
            valid <= 1'b1;
            rdata <= 32'd0;
            case (ARADDR)
                ADDR_AP_CTRL: rdata <= {24'd0, int_auto_restart, 3'd0, ap_ready, ap_idle, int_ap_done, int_ap_start};
                ADDR_GIE: rdata[0] <= int_gie;
                ADDR_IER: rdata[0] <= int_ier;
                ADDR_ISR: rdata[0] <= int_isr;
                ADDR_ROWS_DATA_0: rdata[15:0] <= int_rows;
                ADDR_COLS_DATA_0: rdata[15:0] <= int_cols;
                default: rdata <= 32'd0;
            endcase
        end else if (RREADY)
            valid <= 1'b0;
        // ap_done is cleared when it is read
        if (ap_done)
            int_ap_done <= 1'b1;
        else if (read && ARADDR == ADDR_AP_CTRL)
            int_ap_done <= 1'b0;
        if (write && waddr == ADDR_AP_CTRL && WSTRB[0] && WDATA[0])
            int_ap_start <= 1'b1;
        else if (ap_ready)
            int_ap_start <= int_auto_restart;
        if (write && waddr == ADDR_AP_CTRL && WSTRB[0])
            int_auto_restart <= WDATA[7];
        if (write && waddr == ADDR_GIE && WSTRB[0])
            int_gie <= WDATA[0];
        if (write && waddr == ADDR_IER && WSTRB[0])
            int_ier <= WDATA[0];
        if (int_ier && ap_done)
            int_isr <= 1'b1;
        else if (write && waddr == ADDR_ISR && WSTRB[0])
            int_isr <= int_isr ^ WDATA[0];
        if (write && waddr == ADDR_ROWS_DATA_0)
            int_rows <= WDATA[15:0];
        if (write && waddr == ADDR_COLS_DATA_0)
            int_cols <= WDATA[15:0];
    end
end
endmodule
