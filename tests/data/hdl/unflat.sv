// SPDX-License-Identifier: Apache-2.0
// What cannot cross a region's boundary as it is.
package unflat_types;
    localparam int LANES = 3;
    typedef struct packed {
        logic [7:0] r;
        logic [7:0] g;
        logic [7:0] b;
    } pixel_t;
    typedef struct {
        int count;
    } open_t;
endpackage

interface stream_if;
    logic valid;
    modport source (output valid);
endinterface

module unflat
    import unflat_types::*;
#(
    parameter type sample_t = logic [3:0],
    parameter int DEPTH = 4
) (
    input  logic          clk_i,
    input  logic          rst_ni,
    input  pixel_t        pixel,
    input  open_t         open,
    input  logic [7:0]    lanes [LANES],
    input  sample_t       sample,
    stream_if.source      stream,
    other_if.sink         unknown,
    output logic [$clog2(DEPTH)-1:0] level
);
endmodule
