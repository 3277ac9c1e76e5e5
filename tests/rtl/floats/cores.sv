// SPDX-License-Identifier: Apache-2.0
// What the floating-point cores and the width converter of accl-kaust/zypr's gaussian do, for simulation: the published
// files have their interfaces alone. Rounded to nearest; denormal numbers are 0, infinities and NaN do not occur there.

package floats;
    function automatic real widened(input logic [31:0] x);
        return x[30:23] == 0 ? 0.0 : $bitstoreal({x[31], 11'(x[30:23]) + 11'd896, x[22:0], 29'd0});
    endfunction

    function automatic logic [31:0] narrowed(input real x);
        logic [63:0] wide = $realtobits(x);
        logic [35:0] sum = {1'b0, wide[62:29], 1'b0} + {35'd0, wide[28] && (wide[27:0] != 0 || wide[29])} * 2;
        return wide[62:52] < 11'd897 ? {wide[63], 31'd0} : {wide[63], 8'(sum[34:24] - 11'd896), sum[23:1]};
    endfunction
endpackage

// a result that comes LATENCY enabled clocks after what it is made of
module delayed #(parameter WIDTH = 32, parameter LATENCY = 1) (
    input wire clk, input wire ce, input wire [WIDTH-1:0] d, output wire [WIDTH-1:0] q
);
    reg [WIDTH-1:0] stages [LATENCY];
    assign q = stages[LATENCY-1];
    always @(posedge clk) if (ce) begin
        stages[0] <= d;
        for (int i = 1; i < LATENCY; i++) stages[i] <= stages[i-1];
    end
endmodule

module gaussian_ap_fadd_2_full_dsp_32 (
    input wire aclk,
    input wire aclken,
    input wire s_axis_a_tvalid,
    input wire [31:0] s_axis_a_tdata,
    input wire s_axis_b_tvalid,
    input wire [31:0] s_axis_b_tdata,
    output wire m_axis_result_tvalid,
    output wire [31:0] m_axis_result_tdata
);
    import floats::*;
    logic [31:0] now;
    assign m_axis_result_tvalid = 1'b1;
    always @(*) now = narrowed(widened(s_axis_a_tdata) + widened(s_axis_b_tdata));
    delayed #(32, 2) late (aclk, aclken, now, m_axis_result_tdata);
endmodule

module gaussian_ap_fmul_1_max_dsp_32 (
    input wire aclk,
    input wire aclken,
    input wire s_axis_a_tvalid,
    input wire [31:0] s_axis_a_tdata,
    input wire s_axis_b_tvalid,
    input wire [31:0] s_axis_b_tdata,
    output wire m_axis_result_tvalid,
    output wire [31:0] m_axis_result_tdata
);
    import floats::*;
    logic [31:0] now;
    assign m_axis_result_tvalid = 1'b1;
    always @(*) now = narrowed(widened(s_axis_a_tdata) * widened(s_axis_b_tdata));
    delayed #(32, 1) late (aclk, aclken, now, m_axis_result_tdata);
endmodule

module gaussian_ap_fdiv_7_no_dsp_32 (
    input wire aclk,
    input wire aclken,
    input wire s_axis_a_tvalid,
    input wire [31:0] s_axis_a_tdata,
    input wire s_axis_b_tvalid,
    input wire [31:0] s_axis_b_tdata,
    output wire m_axis_result_tvalid,
    output wire [31:0] m_axis_result_tdata
);
    import floats::*;
    logic [31:0] now;
    assign m_axis_result_tvalid = 1'b1;
    always @(*) now = narrowed(widened(s_axis_a_tdata) / widened(s_axis_b_tdata));
    delayed #(32, 7) late (aclk, aclken, now, m_axis_result_tdata);
endmodule

module gaussian_ap_fexp_6_full_dsp_32 (
    input wire aclk,
    input wire aclken,
    input wire s_axis_a_tvalid,
    input wire [31:0] s_axis_a_tdata,
    output wire m_axis_result_tvalid,
    output wire [31:0] m_axis_result_tdata
);
    import floats::*;
    logic [31:0] now;
    assign m_axis_result_tvalid = 1'b1;
    always @(*) now = narrowed($exp(widened(s_axis_a_tdata)));
    delayed #(32, 6) late (aclk, aclken, now, m_axis_result_tdata);
endmodule

module gaussian_ap_sitofp_2_no_dsp_32 (
    input wire aclk,
    input wire aclken,
    input wire s_axis_a_tvalid,
    input wire [31:0] s_axis_a_tdata,
    output wire m_axis_result_tvalid,
    output wire [31:0] m_axis_result_tdata
);
    import floats::*;
    logic [31:0] now;
    assign m_axis_result_tvalid = 1'b1;
    always @(*) now = narrowed($itor($signed(s_axis_a_tdata)));
    delayed #(32, 2) late (aclk, aclken, now, m_axis_result_tdata);
endmodule

module gaussian_ap_fpext_0_no_dsp_32 (
    input wire s_axis_a_tvalid,
    input wire [31:0] s_axis_a_tdata,
    output wire m_axis_result_tvalid,
    output wire [63:0] m_axis_result_tdata
);
    import floats::*;
    logic [63:0] now;
    assign m_axis_result_tvalid = 1'b1;
    always @(*) now = $realtobits(widened(s_axis_a_tdata));
    assign m_axis_result_tdata = now;
endmodule

module gaussian_ap_dadd_3_full_dsp_64 (
    input wire aclk,
    input wire aclken,
    input wire s_axis_a_tvalid,
    input wire [63:0] s_axis_a_tdata,
    input wire s_axis_b_tvalid,
    input wire [63:0] s_axis_b_tdata,
    output wire m_axis_result_tvalid,
    output wire [63:0] m_axis_result_tdata
);
    import floats::*;
    logic [63:0] now;
    assign m_axis_result_tvalid = 1'b1;
    always @(*) now = $realtobits($bitstoreal(s_axis_a_tdata) + $bitstoreal(s_axis_b_tdata));
    delayed #(64, 3) late (aclk, aclken, now, m_axis_result_tdata);
endmodule

module gaussian_ap_fcmp_0_no_dsp_32 (
    input wire s_axis_a_tvalid,
    input wire [31:0] s_axis_a_tdata,
    input wire s_axis_b_tvalid,
    input wire [31:0] s_axis_b_tdata,
    input wire s_axis_operation_tvalid,
    input wire [7:0] s_axis_operation_tdata,
    output wire m_axis_result_tvalid,
    output wire [7:0] m_axis_result_tdata
);
    import floats::*;
    logic [7:0] now;
    assign m_axis_result_tvalid = 1'b1;
    always @(*) now = {7'd0, (s_axis_operation_tdata[4] && widened(s_axis_a_tdata) == widened(s_axis_b_tdata)) || (s_axis_operation_tdata[5] && widened(s_axis_a_tdata) > widened(s_axis_b_tdata)) || (s_axis_operation_tdata[3] && widened(s_axis_a_tdata) < widened(s_axis_b_tdata))};
    assign m_axis_result_tdata = now;
endmodule

// 24 bits to 8, the lowest byte first
module axis_dwidth_converter_1 (
    input wire aclk, input wire aresetn,
    input wire s_axis_tvalid, output wire s_axis_tready, input wire [23:0] s_axis_tdata, input wire s_axis_tlast,
    output wire m_axis_tvalid, input wire m_axis_tready, output wire [7:0] m_axis_tdata, output wire m_axis_tlast
);
    reg [23:0] held;
    reg [1:0]  left = 2'd0;
    reg        last;
    assign s_axis_tready = left == 2'd0;
    assign m_axis_tvalid = left != 2'd0;
    assign m_axis_tdata = held[7:0];
    assign m_axis_tlast = last && left == 2'd1;
    always @(posedge aclk)
        if (!aresetn)
            left <= 2'd0;
        else if (s_axis_tvalid && s_axis_tready) begin
            left <= 2'd3;
            held <= s_axis_tdata;
            last <= s_axis_tlast;
        end else if (m_axis_tvalid && m_axis_tready) begin
            left <= left - 2'd1;
            held <= held >> 8;
        end
endmodule
