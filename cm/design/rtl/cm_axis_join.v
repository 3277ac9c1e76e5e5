// SPDX-License-Identifier: Apache-2.0
//
// COUNT AXI4-Streams into one, packet by packet, each packet with the number of its stream in TDEST: what
// an AXI MCDMA sorts into channels by. Streams that wait take turns; a packet that has begun is not
// interrupted, so a stream that pauses inside one holds the others up. All streams are as wide as the
// joined one, and each must end its packets with TLAST.
`default_nettype none

module cm_axis_join #(
    parameter COUNT = 2,  // 1 to 16
    parameter BYTES = 4
) (
    input  wire                     clk,
    input  wire                     resetn,
    // stream n in the bits from n * width on
    input  wire [COUNT-1:0]         s_tvalid,
    output wire [COUNT-1:0]         s_tready,
    input  wire [8*BYTES*COUNT-1:0] s_tdata,
    input  wire [BYTES*COUNT-1:0]   s_tkeep,
    input  wire [COUNT-1:0]         s_tlast,
    output reg                      m_tvalid,
    input  wire                     m_tready,
    output reg  [8*BYTES-1:0]       m_tdata,
    output reg  [BYTES-1:0]         m_tkeep,
    output reg                      m_tlast,
    output reg  [3:0]               m_tdest
);
    reg        open;     // a packet has begun whose last beat has not come
    reg  [3:0] current;  // the stream whose packet is, or was last, under way
    reg  [3:0] chosen;

    wire room = !m_tvalid || m_tready;

    // who waits behind `current` comes first, then who waits before it
    integer i;
    always @* begin
        chosen = current;
        if (!open) begin
            for (i = COUNT - 1; i >= 0; i = i - 1)
                if (s_tvalid[i] && i[3:0] <= current) chosen = i[3:0];
            for (i = COUNT - 1; i >= 0; i = i - 1)
                if (s_tvalid[i] && i[3:0] > current) chosen = i[3:0];
        end
    end

    reg               valid, last;
    reg [8*BYTES-1:0] data;
    reg [BYTES-1:0]   keep;
    integer j;
    always @* begin
        valid = 1'b0;
        last  = 1'b0;
        data  = {8*BYTES{1'b0}};
        keep  = {BYTES{1'b0}};
        for (j = 0; j < COUNT; j = j + 1)
            if (chosen == j[3:0]) begin
                valid = s_tvalid[j];
                last  = s_tlast[j];
                data  = s_tdata[8*BYTES*j+:8*BYTES];
                keep  = s_tkeep[BYTES*j+:BYTES];
            end
    end

    genvar n;
    generate
        for (n = 0; n < COUNT; n = n + 1) begin : ready
            localparam [3:0] NUMBER = n;
            assign s_tready[n] = room && chosen == NUMBER;
        end
    endgenerate

    always @(posedge clk) begin
        if (!resetn) begin
            m_tvalid <= 1'b0;
            m_tdata  <= {8*BYTES{1'b0}};
            m_tkeep  <= {BYTES{1'b0}};
            m_tlast  <= 1'b0;
            m_tdest  <= 4'd0;
            open     <= 1'b0;
            current  <= 4'd0;
        end else if (room) begin
            m_tvalid <= valid;
            if (valid) begin
                m_tdata <= data;
                m_tkeep <= keep;
                m_tlast <= last;
                m_tdest <= chosen;
                open    <= !last;
                current <= chosen;
            end
        end
    end
endmodule

`default_nettype wire
