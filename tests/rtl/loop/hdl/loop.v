// SPDX-License-Identifier: Apache-2.0
//
// What goes in comes out, four bytes a beat; registers and a memory for tests:
//   0x000 ident    ro   "LOOP"
//   0x010 scratch  rw   holds what is written
//   0x014 trigger  wo   any write raises the interrupt for one clock
//   0x018 misdeed  wo   1: $fatal, 2: $finish, 3: an endless loop, 4: nothing is answered any more
//   0x800 memory   rw   2 KiB
// Registers begin as a device's do after it was configured, so that it works before its first reset.
`default_nettype none

module loop #(
    parameter [31:0] INVERT = 32'd0
) (
    input  wire        clk,
    input  wire        resetn,
    input  wire [31:0] s_axis_tdata,
    input  wire [3:0]  s_axis_tkeep,
    input  wire        s_axis_tvalid,
    output wire        s_axis_tready,
    input  wire        s_axis_tlast,
    output reg  [31:0] m_axis_tdata,
    output reg  [3:0]  m_axis_tkeep,
    output reg         m_axis_tvalid,
    input  wire        m_axis_tready,
    output reg         m_axis_tlast,
    input  wire [11:0] s_axi_awaddr,
    input  wire        s_axi_awvalid,
    output wire        s_axi_awready,
    input  wire [31:0] s_axi_wdata,
    input  wire [3:0]  s_axi_wstrb,
    input  wire        s_axi_wvalid,
    output wire        s_axi_wready,
    output wire [1:0]  s_axi_bresp,
    output reg         s_axi_bvalid,
    input  wire        s_axi_bready,
    input  wire [11:0] s_axi_araddr,
    input  wire        s_axi_arvalid,
    output wire        s_axi_arready,
    output reg  [31:0] s_axi_rdata,
    output wire [1:0]  s_axi_rresp,
    output reg         s_axi_rvalid,
    input  wire        s_axi_rready,
    (* X_INTERFACE_INFO = "xilinx.com:signal:interrupt:1.0 irq INTERRUPT" *)
    output reg         irq
);
    reg [31:0] scratch, memory [0:511];
    reg        dead;
    wire       write = s_axi_awvalid && s_axi_wvalid && !s_axi_bvalid && !dead;
    wire       read  = s_axi_arvalid && !s_axi_rvalid && !dead;
    wire       room  = !m_axis_tvalid || m_axis_tready;
    integer    lane;
    reg [31:0] spins = 32'd0;

    initial begin
        {m_axis_tdata, m_axis_tkeep, m_axis_tvalid, m_axis_tlast} = 38'd0;
        {s_axi_bvalid, s_axi_rvalid, s_axi_rdata, scratch, irq, dead} = 68'd0;
    end

    assign s_axis_tready = room;
    assign s_axi_awready = write;
    assign s_axi_wready  = write;
    assign s_axi_arready = read;
    assign s_axi_bresp   = 2'b00;
    assign s_axi_rresp   = 2'b00;

    always @(posedge clk) begin
        if (!resetn) m_axis_tvalid <= 1'b0;
        else if (room) begin
            m_axis_tdata  <= s_axis_tdata ^ INVERT;
            m_axis_tkeep  <= s_axis_tkeep;
            m_axis_tlast  <= s_axis_tlast;
            m_axis_tvalid <= s_axis_tvalid;
        end
    end

    always @(posedge clk) begin
        irq <= 1'b0;
        if (!resetn) begin
            s_axi_bvalid <= 1'b0;
            scratch      <= 32'd0;
        end else begin
            if (write) s_axi_bvalid <= 1'b1;
            else if (s_axi_bready) s_axi_bvalid <= 1'b0;
            if (write && s_axi_awaddr[11])
                for (lane = 0; lane < 4; lane = lane + 1)
                    if (s_axi_wstrb[lane]) memory[s_axi_awaddr[10:2]][8*lane+:8] <= s_axi_wdata[8*lane+:8];
            if (write && s_axi_awaddr[11:2] == 10'h004)
                for (lane = 0; lane < 4; lane = lane + 1)
                    if (s_axi_wstrb[lane]) scratch[8*lane+:8] <= s_axi_wdata[8*lane+:8];
            if (write && s_axi_awaddr[11:2] == 10'h005) irq <= 1'b1;
            if (write && s_axi_awaddr[11:2] == 10'h006) misbehave(s_axi_wdata[2:0]);
        end
    end

    task misbehave(input [2:0] how);
        case (how)
            3'd1: $fatal(1, "it was asked to fail");
            3'd2: $finish;
            3'd3: while (spins != 32'hFFFF_FFFF || !resetn || resetn) spins = spins ^ s_axi_wdata;
            3'd4: dead <= 1'b1;
            default: ;
        endcase
    endtask

    always @(posedge clk) begin
        if (!resetn) s_axi_rvalid <= 1'b0;
        else if (read) begin
            s_axi_rvalid <= 1'b1;
            if (s_axi_araddr[11]) s_axi_rdata <= memory[s_axi_araddr[10:2]];
            else if (s_axi_araddr[11:2] == 10'h000) s_axi_rdata <= 32'h4C4F4F50;
            else if (s_axi_araddr[11:2] == 10'h004) s_axi_rdata <= scratch;
            else s_axi_rdata <= 32'd0;
        end else if (s_axi_rready) s_axi_rvalid <= 1'b0;
    end

    wire unused = &{1'b0, s_axi_awaddr[1:0], s_axi_araddr[1:0]};
endmodule

`default_nettype wire
