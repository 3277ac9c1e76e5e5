// SPDX-License-Identifier: Apache-2.0
//
// One AXI4-Stream to COUNT, each beat to the stream that TDEST names, as an AXI MCDMA numbers its channels.
// Beats for a stream that there is not are taken and dropped, so that a wrong number cannot stop the
// others; a stream that takes nothing does: its beat waits in front of theirs.
`default_nettype none

module cm_axis_split #(
    parameter COUNT = 2,  // 1 to 16
    parameter BYTES = 4
) (
    input  wire                     clk,
    input  wire                     resetn,
    input  wire                     s_tvalid,
    output wire                     s_tready,
    input  wire [8*BYTES-1:0]       s_tdata,
    input  wire [BYTES-1:0]         s_tkeep,
    input  wire                     s_tlast,
    input  wire [3:0]               s_tdest,
    // stream n in the bits from n * width on; data is the same for all
    output wire [COUNT-1:0]         m_tvalid,
    input  wire [COUNT-1:0]         m_tready,
    output wire [8*BYTES*COUNT-1:0] m_tdata,
    output wire [BYTES*COUNT-1:0]   m_tkeep,
    output wire [COUNT-1:0]         m_tlast
);
    reg               valid, last;
    reg [8*BYTES-1:0] data;
    reg [BYTES-1:0]   keep;
    reg [3:0]         dest;

    reg there;  // somebody is meant
    reg taken;
    integer i;
    always @* begin
        there = 1'b0;
        taken = 1'b0;
        for (i = 0; i < COUNT; i = i + 1)
            if (dest == i[3:0]) begin
                there = 1'b1;
                taken = m_tready[i];
            end
    end

    assign s_tready = !valid || taken || !there;

    genvar n;
    generate
        for (n = 0; n < COUNT; n = n + 1) begin : out
            localparam [3:0] NUMBER = n;
            assign m_tvalid[n] = valid && dest == NUMBER;
            assign m_tdata[8*BYTES*n+:8*BYTES] = data;
            assign m_tkeep[BYTES*n+:BYTES] = keep;
            assign m_tlast[n] = last;
        end
    endgenerate

    always @(posedge clk) begin
        if (!resetn) begin
            valid <= 1'b0;
            data  <= {8*BYTES{1'b0}};
            keep  <= {BYTES{1'b0}};
            last  <= 1'b0;
            dest  <= 4'd0;
        end else if (s_tready) begin
            valid <= s_tvalid;
            if (s_tvalid) begin
                data <= s_tdata;
                keep <= s_tkeep;
                last <= s_tlast;
                dest <= s_tdest;
            end
        end
    end
endmodule

`default_nettype wire
