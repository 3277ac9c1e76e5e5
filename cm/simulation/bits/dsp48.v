// SPDX-License-Identifier: Apache-2.0
//
// DSP48E1 (UG479) as far as configured logic is run: multiplier, pre-adder, adder with its registers. Not its
// cascades, logic functions, SIMD and detection of patterns.
module cm_dsp48 #(
    parameter AREG = 1, BREG = 1, CREG = 1, DREG = 1, ADREG = 1, MREG = 1, PREG = 1,
    parameter INMODEREG = 1, OPMODEREG = 1, ALUMODEREG = 1, CARRYINREG = 1, DPORT = 0
) (
    input  wire        CLK,
    input  wire [29:0] A,
    input  wire [17:0] B,
    input  wire [47:0] C,
    input  wire [24:0] D,
    input  wire [ 4:0] INMODE,
    input  wire [ 6:0] OPMODE,
    input  wire [ 3:0] ALUMODE,
    input  wire        CARRYIN,
    input  wire        CEA1, CEA2, CEB1, CEB2, CEC, CED, CEAD, CEM, CEP, CEINMODE, CECTRL, CEALUMODE, CECARRYIN,
    input  wire        RSTA, RSTB, RSTC, RSTD, RSTM, RSTP, RSTINMODE, RSTCTRL, RSTALUMODE, RSTALLCARRYIN,
    output wire [47:0] P
);
    reg [29:0] a_1 = 0, a_2 = 0;
    reg [17:0] b_1 = 0, b_2 = 0;
    reg [47:0] c_r = 0, p_r = 0;
    reg [24:0] d_r = 0, ad_r = 0;
    reg [42:0] m_r = 0;
    reg [ 4:0] in_r = 0;
    reg [ 6:0] op_r = 0;
    reg [ 3:0] alu_r = 0;
    reg        carry_r = 0;

    wire [29:0] a_first = AREG == 2 ? a_1 : A, a_last = AREG == 0 ? A : a_2;
    wire [17:0] b_first = BREG == 2 ? b_1 : B, b_last = BREG == 0 ? B : b_2;
    wire [47:0] c = CREG == 0 ? C : c_r;
    wire [24:0] d = DREG == 0 ? D : d_r;
    wire [ 4:0] in = INMODEREG == 0 ? INMODE : in_r;
    wire [ 6:0] op = OPMODEREG == 0 ? OPMODE : op_r;
    wire [ 3:0] alu = ALUMODEREG == 0 ? ALUMODE : alu_r;
    wire        carry = CARRYINREG == 0 ? CARRYIN : carry_r;

    wire [29:0] a_taken = in[0] && AREG != 0 ? a_1 : a_last;
    wire [17:0] b_taken = in[4] && BREG != 0 ? b_1 : b_last;
    wire [24:0] a_gated = in[1] ? 25'd0 : a_taken[24:0];
    wire [24:0] d_gated = in[2] ? d : 25'd0;
    wire [24:0] sum = in[3] ? d_gated - a_gated : d_gated + a_gated;
    wire [24:0] factor = DPORT == 0 ? a_gated : ADREG == 0 ? sum : ad_r;
    wire signed [42:0] product = $signed(factor) * $signed(b_taken);
    wire [42:0] m = MREG == 0 ? product : m_r;

    wire [47:0] x = op[1:0] == 2'd1 ? {{5{m[42]}}, m} : op[1:0] == 2'd2 ? p_r : op[1:0] == 2'd3 ? {a_last, b_last} : 48'd0;
    wire [47:0] y = op[3:2] == 2'd2 ? ~48'd0 : op[3:2] == 2'd3 ? c : 48'd0;  // 1: the other half of the product
    wire [47:0] z = op[6:4] == 3'd3 ? c : op[6:4] == 3'd2 || op[6:4] == 3'd4 ? p_r :
        op[6:4] == 3'd6 ? {{17{p_r[47]}}, p_r[47:17]} : 48'd0;
    wire [47:0] total = (alu[0] ? ~z : z) + x + y + {47'd0, carry};
    wire [47:0] result = alu[1] ? ~total : total;

    assign P = PREG == 0 ? result : p_r;

    always @(posedge CLK) begin
        if (RSTA) a_1 <= 0; else if (CEA1) a_1 <= A;
        if (RSTA) a_2 <= 0; else if (CEA2) a_2 <= a_first;
        if (RSTB) b_1 <= 0; else if (CEB1) b_1 <= B;
        if (RSTB) b_2 <= 0; else if (CEB2) b_2 <= b_first;
        if (RSTC) c_r <= 0; else if (CEC) c_r <= C;
        if (RSTD) d_r <= 0; else if (CED) d_r <= D;
        if (RSTD) ad_r <= 0; else if (CEAD) ad_r <= sum;
        if (RSTM) m_r <= 0; else if (CEM) m_r <= product;
        if (RSTP) p_r <= 0; else if (CEP) p_r <= result;
        if (RSTINMODE) in_r <= 0; else if (CEINMODE) in_r <= INMODE;
        if (RSTCTRL) op_r <= 0; else if (CECTRL) op_r <= OPMODE;
        if (RSTALUMODE) alu_r <= 0; else if (CEALUMODE) alu_r <= ALUMODE;
        if (RSTALLCARRYIN) carry_r <= 0; else if (CECARRYIN) carry_r <= CARRYIN;
    end
endmodule
