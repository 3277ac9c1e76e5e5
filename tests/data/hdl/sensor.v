// SPDX-License-Identifier: Apache-2.0
// Interfaces that only a protocols file tells.
module sensor (
    input  wire       pclk,
    input  wire       rst,
    output wire [9:0] cam_pix,
    output wire       cam_vsync,
    output wire       cam_hsync,
    input  wire       cam_pause,
    output wire       go,
    input  wire       ok
);
endmodule
