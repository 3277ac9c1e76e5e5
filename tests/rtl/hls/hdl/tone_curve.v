// SPDX-License-Identifier: Apache-2.0
// A table of 256 bytes as HLS makes one: a file beside this one, read when the simulation begins.
`timescale 1 ns / 1 ps
module tone_curve_rom (addr0, ce0, q0, clk);
parameter DWIDTH = 8;
parameter AWIDTH = 8;
parameter MEM_SIZE = 256;
input [AWIDTH-1:0] addr0;
input ce0;
output reg [DWIDTH-1:0] q0;
input clk;

(* ram_style = "distributed" *) reg [DWIDTH-1:0] ram[0:MEM_SIZE-1];

initial begin
    if (MEM_SIZE != 256)
        $error("a table has 256 bytes");
    $readmemh("./tone_curve_rom.dat", ram);
end

always @(posedge clk)
begin
    if (ce0)
        q0 <= ram[addr0];
end
endmodule
