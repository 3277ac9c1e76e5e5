// SPDX-License-Identifier: Apache-2.0
//
// Multiplies every pixel's colours by gain / 16, with saturation.
`default_nettype none

module pixel_gain (
    input  wire        clk,
    input  wire        resetn,
    input  wire [31:0] s_axis_tdata,
    input  wire        s_axis_tvalid,
    output wire        s_axis_tready,
    input  wire        s_axis_tlast,
    output reg  [31:0] m_axis_tdata,
    output reg         m_axis_tvalid,
    input  wire        m_axis_tready,
    output reg         m_axis_tlast,
    // 0x00 gain: what every colour is multiplied with, in 1/16
    input  wire [5:0]  s_axi_awaddr,
    input  wire        s_axi_awvalid,
    output wire        s_axi_awready,
    input  wire [31:0] s_axi_wdata,
    input  wire [3:0]  s_axi_wstrb,
    input  wire        s_axi_wvalid,
    output wire        s_axi_wready,
    output wire [1:0]  s_axi_bresp,
    output reg         s_axi_bvalid,
    input  wire        s_axi_bready,
    input  wire [5:0]  s_axi_araddr,
    input  wire        s_axi_arvalid,
    output wire        s_axi_arready,
    output reg  [31:0] s_axi_rdata,
    output wire [1:0]  s_axi_rresp,
    output reg         s_axi_rvalid,
    input  wire        s_axi_rready
);
    wire take = s_axis_tvalid && s_axis_tready;
    assign s_axis_tready = !m_axis_tvalid || m_axis_tready;

    wire write = s_axi_awvalid && s_axi_wvalid && !s_axi_bvalid;
    wire read  = s_axi_arvalid && !s_axi_rvalid;
    reg  [7:0] gain;

    assign s_axi_awready = write;
    assign s_axi_wready  = write;
    assign s_axi_arready = read;
    assign s_axi_bresp   = 2'b00;
    assign s_axi_rresp   = 2'b00;

    function [7:0] amplify(input [7:0] value, input [7:0] factor);
        reg [15:0] product;
        begin
            product = ({8'd0, value} * {8'd0, factor}) >> 4;
            amplify = product > 16'd255 ? 8'd255 : product[7:0];
        end
    endfunction

    always @(posedge clk) begin
        if (!resetn) begin
            s_axi_bvalid <= 1'b0;
            s_axi_rvalid <= 1'b0;
            s_axi_rdata  <= 32'd0;
            gain         <= 8'd16;
        end else begin
            if (write) s_axi_bvalid <= 1'b1;
            else if (s_axi_bready) s_axi_bvalid <= 1'b0;
            if (write && s_axi_wstrb[0] && s_axi_awaddr == 6'd0) gain <= s_axi_wdata[7:0];
            if (read) begin
                s_axi_rvalid <= 1'b1;
                s_axi_rdata  <= s_axi_araddr == 6'd0 ? {24'd0, gain} : 32'd0;
            end else if (s_axi_rready) s_axi_rvalid <= 1'b0;
        end
    end

    wire unused = &{1'b0, s_axi_wdata[31:8], s_axi_wstrb[3:1], s_axis_tdata[31:24]};

    always @(posedge clk) begin
        if (!resetn) begin
            m_axis_tvalid <= 1'b0;
            m_axis_tlast  <= 1'b0;
            m_axis_tdata  <= 32'd0;
        end else begin
            if (s_axis_tready) m_axis_tvalid <= take;
            if (take) begin
                m_axis_tdata <= {8'd0, amplify(s_axis_tdata[23:16], gain), amplify(s_axis_tdata[15:8], gain),
                                 amplify(s_axis_tdata[7:0], gain)};
                m_axis_tlast <= s_axis_tlast;
            end
        end
    end
endmodule

`default_nettype wire
