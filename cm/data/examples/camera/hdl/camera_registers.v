// SPDX-License-Identifier: Apache-2.0
//
// Registers that the camera modules share, on AXI4-Lite:
//   0x00 ident     ro   which module this is
//   0x04 frames    ro   frames that have left since reset
//   0x10 focus     rw   of the lens: 1 is sharp, 0 to 15
//   0x14 zoom      rw   of the lens, 1 to 8
//   0x18 threshold rw   of the edge detection, 0 to 255
//   0x1C palette   rw   colours of colorise, 0 to 3
`default_nettype none

module camera_registers #(
    parameter [31:0] ID = 32'd0
) (
    input  wire        clk,
    input  wire        resetn,
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
    input  wire        frame_done,
    output reg  [3:0]  focus,
    output reg  [3:0]  zoom,
    output reg  [7:0]  threshold,
    output reg  [1:0]  palette
);
    wire write = s_axi_awvalid && s_axi_wvalid && !s_axi_bvalid;
    reg [31:0] frames;
    wire read  = s_axi_arvalid && !s_axi_rvalid;

    assign s_axi_awready = write;
    assign s_axi_wready  = write;
    assign s_axi_arready = read;
    assign s_axi_bresp   = 2'b00;
    assign s_axi_rresp   = 2'b00;

    always @(posedge clk) begin
        if (!resetn) begin
            s_axi_bvalid <= 1'b0;
            focus        <= 4'd1;
            zoom         <= 4'd1;
            threshold    <= 8'd0;
            palette      <= 2'd0;
        end else begin
            if (write) s_axi_bvalid <= 1'b1;
            else if (s_axi_bready) s_axi_bvalid <= 1'b0;
            if (write && s_axi_wstrb[0])
                case (s_axi_awaddr[7:2])
                    6'h04: focus <= s_axi_wdata[3:0];
                    6'h05: zoom <= s_axi_wdata[3:0];
                    6'h06: threshold <= s_axi_wdata[7:0];
                    6'h07: palette <= s_axi_wdata[1:0];
                    default: ;
                endcase
        end
    end

    always @(posedge clk) begin
        if (!resetn) frames <= 32'd0;
        else if (frame_done) frames <= frames + 32'd1;
    end

    always @(posedge clk) begin
        if (!resetn) begin
            s_axi_rvalid <= 1'b0;
            s_axi_rdata  <= 32'd0;
        end else if (read) begin
            s_axi_rvalid <= 1'b1;
            case (s_axi_araddr[7:2])
                6'h00: s_axi_rdata <= ID;
                6'h01: s_axi_rdata <= frames;
                6'h04: s_axi_rdata <= {28'd0, focus};
                6'h05: s_axi_rdata <= {28'd0, zoom};
                6'h06: s_axi_rdata <= {24'd0, threshold};
                6'h07: s_axi_rdata <= {30'd0, palette};
                default: s_axi_rdata <= 32'd0;
            endcase
        end else if (s_axi_rready) s_axi_rvalid <= 1'b0;
    end

    wire unused = &{1'b0, s_axi_wdata[31:8], s_axi_wstrb[3:1], s_axi_awaddr[1:0], s_axi_araddr[1:0]};
endmodule

`default_nettype wire
