// SPDX-License-Identifier: Apache-2.0
// A tone curve for pictures of 24 bits, with the traits of what HLS makes: ap_ctrl, `#0`, a table in a file, the names
// of Verilog's and not of SystemVerilog's keywords, and a frame that begins where TUSER says so.
`timescale 1 ns / 1 ps

module tone (
        s_axi_control_AWVALID, s_axi_control_AWREADY, s_axi_control_AWADDR,
        s_axi_control_WVALID, s_axi_control_WREADY, s_axi_control_WDATA, s_axi_control_WSTRB,
        s_axi_control_ARVALID, s_axi_control_ARREADY, s_axi_control_ARADDR,
        s_axi_control_RVALID, s_axi_control_RREADY, s_axi_control_RDATA, s_axi_control_RRESP,
        s_axi_control_BVALID, s_axi_control_BREADY, s_axi_control_BRESP,
        ap_clk, ap_rst_n, interrupt,
        input_r_TDATA, input_r_TKEEP, input_r_TUSER, input_r_TLAST, input_r_TVALID, input_r_TREADY,
        output_r_TDATA, output_r_TKEEP, output_r_TUSER, output_r_TLAST, output_r_TVALID, output_r_TREADY
);

parameter C_S_AXI_CONTROL_DATA_WIDTH = 32;
parameter C_S_AXI_CONTROL_ADDR_WIDTH = 5;
parameter C_S_AXI_CONTROL_WSTRB_WIDTH = (32 / 8);

input   s_axi_control_AWVALID;
output  s_axi_control_AWREADY;
input  [C_S_AXI_CONTROL_ADDR_WIDTH - 1:0] s_axi_control_AWADDR;
input   s_axi_control_WVALID;
output  s_axi_control_WREADY;
input  [C_S_AXI_CONTROL_DATA_WIDTH - 1:0] s_axi_control_WDATA;
input  [C_S_AXI_CONTROL_WSTRB_WIDTH - 1:0] s_axi_control_WSTRB;
input   s_axi_control_ARVALID;
output  s_axi_control_ARREADY;
input  [C_S_AXI_CONTROL_ADDR_WIDTH - 1:0] s_axi_control_ARADDR;
output  s_axi_control_RVALID;
input   s_axi_control_RREADY;
output [C_S_AXI_CONTROL_DATA_WIDTH - 1:0] s_axi_control_RDATA;
output [1:0] s_axi_control_RRESP;
output  s_axi_control_BVALID;
input   s_axi_control_BREADY;
output [1:0] s_axi_control_BRESP;
input   ap_clk;
input   ap_rst_n;
output  interrupt;
input  [23:0] input_r_TDATA;
input  [2:0] input_r_TKEEP;
input  [0:0] input_r_TUSER;
input  [0:0] input_r_TLAST;
input   input_r_TVALID;
output  input_r_TREADY;
output [23:0] output_r_TDATA;
output [2:0] output_r_TKEEP;
output [0:0] output_r_TUSER;
output [0:0] output_r_TLAST;
output  output_r_TVALID;
input   output_r_TREADY;

reg ap_rst_n_inv;
reg running = 1'b0;
reg framed = 1'b0;
reg filled = 1'b0;
reg [31:0] left;
reg [15:0] do;  // pixels of the line that have been taken
reg user_0, last_0;
wire [15:0] rows, cols;
wire ap_start;
wire bit = input_r_TVALID && input_r_TREADY;

initial begin
#0 left = 32'd0;
#0 do = 16'd0;
#0 user_0 = 1'b0;
#0 last_0 = 1'b0;
end

always @ (*) begin
    ap_rst_n_inv = ~ap_rst_n;
end

// a frame begins with TUSER: what comes before is not part of one
wire begins = running && !framed && input_r_TUSER[0];
wire takes = running && (framed || begins);
wire room = !filled || output_r_TREADY;
assign input_r_TREADY = running && (room || (!framed && !input_r_TUSER[0]));
wire int = bit && takes;
wire ends = int && left == 32'd1;
wire ap_done = filled && output_r_TREADY && running && framed && left == 32'd0;

always @(posedge ap_clk) begin
    if (ap_rst_n_inv) begin
        running <= 1'b0;
        framed <= 1'b0;
        filled <= 1'b0;
    end else begin
        if (!running && ap_start && rows != 16'd0 && cols != 16'd0) begin
            running <= 1'b1;
            framed <= 1'b0;
            left <= rows * cols;
            do <= 16'd0;
        end
        if (ap_done)
            running <= 1'b0;
        if (room)
            filled <= int;
        if (int) begin
            framed <= 1'b1;
            left <= left - 32'd1;
            user_0 <= begins;
            last_0 <= do == cols - 16'd1;
            do <= do == cols - 16'd1 ? 16'd0 : do + 16'd1;
        end
    end
end

genvar channel;
generate
    for (channel = 0; channel < 3; channel = channel + 1) begin : curves
        tone_curve_rom curve (
            .clk(ap_clk), .ce0(int),
            .addr0(input_r_TDATA[8 * channel +: 8]), .q0(output_r_TDATA[8 * channel +: 8])
        );
    end
endgenerate

assign output_r_TVALID = filled;
assign output_r_TKEEP = 3'b111;
assign output_r_TUSER = user_0;
assign output_r_TLAST = last_0;

tone_control_s_axi #(
    .C_S_AXI_ADDR_WIDTH(C_S_AXI_CONTROL_ADDR_WIDTH), .C_S_AXI_DATA_WIDTH(C_S_AXI_CONTROL_DATA_WIDTH)
) control (
    .ACLK(ap_clk), .ARESET(ap_rst_n_inv),
    .AWADDR(s_axi_control_AWADDR), .AWVALID(s_axi_control_AWVALID), .AWREADY(s_axi_control_AWREADY),
    .WDATA(s_axi_control_WDATA), .WSTRB(s_axi_control_WSTRB),
    .WVALID(s_axi_control_WVALID), .WREADY(s_axi_control_WREADY),
    .BRESP(s_axi_control_BRESP), .BVALID(s_axi_control_BVALID), .BREADY(s_axi_control_BREADY),
    .ARADDR(s_axi_control_ARADDR), .ARVALID(s_axi_control_ARVALID), .ARREADY(s_axi_control_ARREADY),
    .RDATA(s_axi_control_RDATA), .RRESP(s_axi_control_RRESP),
    .RVALID(s_axi_control_RVALID), .RREADY(s_axi_control_RREADY),
    .interrupt(interrupt),
    .ap_start(ap_start), .ap_done(ap_done), .ap_ready(ap_done), .ap_idle(!running),
    .rows(rows), .cols(cols)
);
endmodule
