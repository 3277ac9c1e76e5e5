// SPDX-License-Identifier: Apache-2.0
//
// AXI4-Stream of one width to another, byte for byte: a DMA engine has 8, 16, 32 … bits, a module's
// pixels may have 24. The bytes of a packet are packed without gaps; its last beat has TKEEP low above
// the last byte. Every packet begins in lane 0, so that lanes shift by multiples of what both widths
// have in common, which keeps the shifters small. Bytes with TKEEP low inside a packet pass as they are.
`default_nettype none

module cm_axis_width #(
    parameter IN_BYTES  = 4,
    parameter OUT_BYTES = 3
) (
    input  wire                   clk,
    input  wire                   resetn,
    input  wire                   s_tvalid,
    output wire                   s_tready,
    input  wire [8*IN_BYTES-1:0]  s_tdata,
    input  wire [IN_BYTES-1:0]    s_tkeep,
    input  wire                   s_tlast,
    output wire                   m_tvalid,
    input  wire                   m_tready,
    output wire [8*OUT_BYTES-1:0] m_tdata,
    output wire [OUT_BYTES-1:0]   m_tkeep,
    output wire                   m_tlast
);
    function integer common(input integer a, input integer b);
        integer x, y, rest;
        begin
            x = a;
            y = b;
            while (y != 0) begin
                rest = x % y;
                x = y;
                y = rest;
            end
            common = x;
        end
    endfunction

    localparam integer UNIT = common(IN_BYTES, OUT_BYTES);  // bytes that lanes shift by
    localparam integer IN = IN_BYTES / UNIT;
    localparam integer OUT = OUT_BYTES / UNIT;
    // so much that neither side waits for the other: not ready only while a beat out follows
    localparam integer ROOM = IN + 2 * OUT;
    localparam integer BITS = $clog2(ROOM + 1);
    localparam [BITS-1:0] ALL_IN = IN[BITS-1:0];
    localparam [BITS-1:0] ALL_OUT = OUT[BITS-1:0];
    localparam [BITS-1:0] FULL = ROOM[BITS-1:0] - ALL_IN;
    localparam integer LANE = 9 * UNIT;  // of each byte: TKEEP, then eight bits of data

    reg [LANE*ROOM-1:0] store;
    reg [BITS-1:0]      held;  // units in the store
    reg                 last;  // the store ends with a packet's last byte: nothing is taken until it is out

    wire take = s_tvalid && s_tready;
    wire give = m_tvalid && m_tready;

    assign s_tready = !last && held <= FULL;
    assign m_tvalid = held >= ALL_OUT || last;
    assign m_tlast  = last && held <= ALL_OUT;

    // units of a beat: all but those above the last byte of a packet
    reg [BITS-1:0]    count;
    reg [LANE*IN-1:0] beat;
    integer unit_index, byte_index;
    always @* begin
        count = s_tlast ? {BITS{1'b0}} : ALL_IN;
        for (byte_index = 0; byte_index < IN_BYTES; byte_index = byte_index + 1)
            beat[9*byte_index+:9] = {s_tkeep[byte_index], s_tdata[8*byte_index+:8] & {8{s_tkeep[byte_index]}}};
        for (unit_index = 0; unit_index < IN; unit_index = unit_index + 1)
            if (s_tlast && |s_tkeep[UNIT*unit_index+:UNIT]) count = unit_index[BITS-1:0] + 1'b1;
    end

    wire [BITS-1:0]      gone = held >= ALL_OUT ? ALL_OUT : held;
    wire [BITS-1:0]      left = give ? held - gone : held;
    wire [LANE*ROOM-1:0] rest = give ? store >> (LANE * OUT) : store;
    wire [LANE*ROOM-1:0] fresh = {{LANE*(ROOM-IN){1'b0}}, beat} << (LANE * left);

    always @(posedge clk) begin
        if (!resetn) begin
            store <= {LANE*ROOM{1'b0}};
            held  <= {BITS{1'b0}};
            last  <= 1'b0;
        end else begin
            store <= take ? rest | fresh : rest;
            held  <= take ? left + count : left;
            last  <= take ? s_tlast : last && !(give && m_tlast);
        end
    end

    genvar lane;
    generate
        for (lane = 0; lane < OUT_BYTES; lane = lane + 1) begin : out
            assign m_tdata[8*lane+:8] = store[9*lane+:8];
            assign m_tkeep[lane] = store[9*lane+8];
        end
    endgenerate
endmodule

`default_nettype wire
