// SPDX-License-Identifier: Apache-2.0
// Pixels times the register `gain` (offset 0, 1 to 15), cut at 255.
`default_nettype none

module night (
    input  wire        clk,
    input  wire        resetn,
    input  wire [7:0]  s_axis_tdata,
    input  wire        s_axis_tvalid,
    output wire        s_axis_tready,
    input  wire        s_axis_tlast,
    output wire [7:0]  m_axis_tdata,
    output wire        m_axis_tvalid,
    input  wire        m_axis_tready,
    output wire        m_axis_tlast,
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
    output wire [31:0] s_axi_rdata,
    output wire [1:0]  s_axi_rresp,
    output reg         s_axi_rvalid,
    input  wire        s_axi_rready
);
    reg  [3:0]  gain;
    wire [11:0] product = s_axis_tdata * gain;
    wire        write = s_axi_awvalid && s_axi_wvalid && !s_axi_bvalid;

    assign m_axis_tdata  = |product[11:8] ? 8'd255 : product[7:0];
    assign m_axis_tvalid = s_axis_tvalid && resetn;
    assign m_axis_tlast  = s_axis_tlast;
    assign s_axis_tready = m_axis_tready && resetn;
    assign s_axi_awready = write;
    assign s_axi_wready  = write;
    assign s_axi_arready = s_axi_arvalid && !s_axi_rvalid;
    assign s_axi_rdata   = {28'd0, gain};
    assign s_axi_bresp   = 2'b00;
    assign s_axi_rresp   = 2'b00;

    always @(posedge clk) begin
        if (!resetn) begin
            gain         <= 4'd2;
            s_axi_bvalid <= 1'b0;
            s_axi_rvalid <= 1'b0;
        end else begin
            if (write && s_axi_wstrb[0] && s_axi_awaddr[7:2] == 6'd0) gain <= s_axi_wdata[3:0];
            s_axi_bvalid <= write || (s_axi_bvalid && !s_axi_bready);
            s_axi_rvalid <= s_axi_arready || (s_axi_rvalid && !s_axi_rready);
        end
    end

    wire unused = &{1'b0, s_axi_wdata[31:4], s_axi_wstrb[3:1], s_axi_awaddr[1:0], s_axi_araddr};
endmodule

`default_nettype wire
