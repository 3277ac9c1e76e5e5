// SPDX-License-Identifier: Apache-2.0
// An image filter as modules of this project look: registers, stream in, stream out, interrupt.
`default_nettype none
`include "sizes.vh"

module camera_edge #(
    parameter integer DATA_WIDTH = 24,
    parameter integer USER_WIDTH = 1,
    localparam integer KEEP_WIDTH = DATA_WIDTH / 8
) (
    input  wire                        aclk,
    input  wire                        aresetn,
    // registers
    input  wire [`REGISTER_BITS-1:0]   s_axi_awaddr,
    input  wire [2:0]                  s_axi_awprot,
    input  wire                        s_axi_awvalid,
    output wire                        s_axi_awready,
    input  wire [31:0]                 s_axi_wdata,
    input  wire [3:0]                  s_axi_wstrb,
    input  wire                        s_axi_wvalid,
    output wire                        s_axi_wready,
    output wire [1:0]                  s_axi_bresp,
    output wire                        s_axi_bvalid,
    input  wire                        s_axi_bready,
    input  wire [`REGISTER_BITS-1:0]   s_axi_araddr,
    input  wire [2:0]                  s_axi_arprot,
    input  wire                        s_axi_arvalid,
    output wire                        s_axi_arready,
    output wire [31:0]                 s_axi_rdata,
    output wire [1:0]                  s_axi_rresp,
    output wire                        s_axi_rvalid,
    input  wire                        s_axi_rready,
    // pixels
    input  wire [DATA_WIDTH-1:0]       s_axis_tdata,
    input  wire [KEEP_WIDTH-1:0]       s_axis_tkeep,
    input  wire [USER_WIDTH-1:0]       s_axis_tuser,
    input  wire                        s_axis_tlast,
    input  wire                        s_axis_tvalid,
    output wire                        s_axis_tready,
    output wire [DATA_WIDTH-1:0]       m_axis_tdata,
    output wire [KEEP_WIDTH-1:0]       m_axis_tkeep,
    output wire [USER_WIDTH-1:0]       m_axis_tuser,
    output wire                        m_axis_tlast,
    output wire                        m_axis_tvalid,
    input  wire                        m_axis_tready,
    output wire                        irq_frame_done,
    output wire [3:0]                  status_leds
);
    generate
        if (DATA_WIDTH == 24) begin : rgb
            camera_edge_kernel kernel (.clk(aclk));
        end
    endgenerate
endmodule

module camera_edge_kernel (input wire clk);
endmodule
`default_nettype wire
