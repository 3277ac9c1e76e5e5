// SPDX-License-Identifier: Apache-2.0
//
// A bit of everything that a slice can be: registers with and without enable, set and reset, clocked and not; carry
// chains; wide multiplexers; memory and shift registers in look-up tables.
module everything (
    input  wire       clk,
    input  wire [7:0] a,
    output wire [7:0] y
);
    integer k;
    reg  [7:0]  p = 8'h11, r = 8'd0, q = 8'd5, m = 8'd0;
    reg  [15:0] c = 16'h0003;
    reg         t = 1'b1;
    reg  [11:0] short = 12'd0;
    reg  [19:0] long = 20'd0;
    reg  [3:0]  any = 4'h9;
    reg  [7:0]  memory [0:31];
    wire [7:0]  x = {a[6:0], a[7]} ^ {a[5:0], a[7:6]};
    wire [8:0]  d = {1'b0, x} - {1'b0, p};

    initial for (k = 0; k < 32; k = k + 1) memory[k] = 8'd0;

    always @(posedge clk) begin
        p <= x;
        r <= d[8] ? -d[7:0] : d[7:0];
        if (a[0]) c <= c + {12'd0, a[3:1], 1'b1};
        t <= ~(t & a[2]);
        memory[c[4:0]] <= d[7:0];
        short <= {short[10:0], q[0]};
        long  <= {long[18:0], q[1]};
        if (a[3]) q <= 8'h81;
        else if (a[1]) q <= d[7:0] ^ {8{d[8]}} ^ c[15:8];
        case (c[3:0])
            4'd0: m <= p;
            4'd1: m <= r;
            4'd2: m <= q;
            4'd3: m <= a;
            4'd4: m <= ~p;
            4'd5: m <= x ^ q;
            4'd6: m <= r ^ p;
            4'd7: m <= {p[3:0], q[3:0]};
            4'd8: m <= c[7:0];
            4'd9: m <= c[15:8];
            default: m <= r & q;
        endcase
    end

    always @(posedge clk or posedge a[7]) begin
        if (a[7]) any <= 4'h6;
        else any <= any + q[3:0];
    end

    assign y = r ^ {r[0], r[7:1]} ^ m ^ memory[a[4:0]] ^ {short[11], t, long[19], 1'b0, any};
endmodule
