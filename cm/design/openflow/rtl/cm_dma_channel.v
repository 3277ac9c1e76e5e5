// SPDX-License-Identifier: Apache-2.0
//
// Registers of one direction of the DMA engine, as PG021 has them in direct register mode:
//   0x00 DMACR   [0] RS, [1] reads 1, [2] reset, [12] IOC_IrqEn, [13] Dly_IrqEn, [14] Err_IrqEn,
//                [23:16] IRQThreshold and [31:24] IRQDelay, which are kept and have no effect
//   0x04 DMASR   [0] halted, [1] idle, [4] internal, [5] slave, [6] decode error, [12] IOC_Irq, [14] Err_Irq (w1c),
//                [23:16] IRQThresholdSts
//   0x18 SA, DA  where the buffer begins, a multiple of the stream's bytes: else an internal error
//   0x28 LENGTH  bytes; writing one that is not 0 begins the transfer of a channel that runs and has none;
//                behind a received packet its bytes
// RS = 0 and errors end a transfer; halted is 1 when nothing is under way any more. Only a reset clears errors.
`default_nettype none

module cm_dma_channel #(
    parameter LENGTH_BITS = 23,
    parameter STREAM_BYTES = 1,
    parameter RECEIVES = 0       // to memory: an error of memory is an internal one, too
) (
    input  wire                   clk,
    input  wire                   resetn,     // of the device, or by either channel
    input  wire                   resetting,  // by either channel, until nothing is under way
    output wire                   reset,
    input  wire                   write,
    input  wire [            3:0] waddr,      // words
    input  wire [           31:0] wdata,
    input  wire [            3:0] raddr,
    output reg  [           31:0] rdata,
    output reg                    interrupt,
    output reg                    start,
    output reg  [           31:0] address,
    output reg  [LENGTH_BITS-1:0] length,
    output wire                   stop,
    input  wire                   quiet,
    input  wire                   done,
    input  wire [LENGTH_BITS-1:0] left,       // of the buffer
    input  wire                   internal_error,
    input  wire                   slave_error,
    input  wire                   decode_error
);
    localparam [1:0] HALTED = 2'd0, RUNNING = 2'd1, STOPPING = 2'd2;
    localparam [3:0] DMACR = 4'h0, DMASR = 4'h1, ADDRESS = 4'h6, LENGTH = 4'hA;
    localparam [31:0] BEHIND = STREAM_BYTES - 1;  // address bits below a beat

    reg [1:0] state;
    reg run, active, idle;
    reg [2:0] enable, errors;        // Err, Dly, IOC; decode, slave, internal
    reg ioc, err;
    reg [7:0] threshold, delay;

    wire begins = write && waddr == LENGTH && wdata[LENGTH_BITS-1:0] != {LENGTH_BITS{1'b0}} && state == RUNNING
               && run && !active;
    wire astray = begins && |(address & BEHIND);
    wire of_memory = slave_error || decode_error;
    wire failed = internal_error || of_memory || astray;

    assign reset = write && waddr == DMACR && wdata[2];
    assign stop  = state == STOPPING || resetting;

    always @(posedge clk) begin
        start <= begins && !astray;
        if (!resetn || resetting) begin
            state     <= HALTED;
            run       <= 1'b0;
            active    <= 1'b0;
            idle      <= 1'b0;
            enable    <= 3'b000;
            errors    <= 3'b000;
            ioc       <= 1'b0;
            err       <= 1'b0;
            threshold <= 8'd1;
            delay     <= 8'd0;
            address   <= 32'd0;
            length    <= {LENGTH_BITS{1'b0}};
            interrupt <= 1'b0;
            start     <= 1'b0;
        end else begin
            interrupt <= (ioc && enable[0]) || (err && enable[2]);
            if (write && waddr == DMACR) begin
                run    <= wdata[0] && errors == 3'b000;
                enable <= wdata[14:12];
                delay  <= wdata[31:24];
                if (wdata[23:16] != 8'd0) threshold <= wdata[23:16];
            end
            if (write && waddr == DMASR) begin
                if (wdata[12]) ioc <= 1'b0;
                if (wdata[14]) err <= 1'b0;
            end
            if (write && waddr == ADDRESS) address <= wdata;
            if (begins) begin
                length <= wdata[LENGTH_BITS-1:0];
                active <= 1'b1;
                idle   <= 1'b0;
            end
            if (done) begin
                length <= length - left;
                active <= 1'b0;
                idle   <= 1'b1;
                ioc    <= 1'b1;
            end
            if (failed) begin
                errors <= errors | {decode_error, slave_error,
                                    internal_error || astray || (RECEIVES != 0 && of_memory)};
                if (errors == 3'b000) err <= 1'b1;
                run    <= 1'b0;
            end
            case (state)
                HALTED:  if (run && !failed) state <= RUNNING;
                RUNNING: if (!run || failed) state <= STOPPING;
                default: if (quiet) state <= HALTED;
            endcase
            if (state == STOPPING) begin
                active <= 1'b0;
                idle   <= 1'b0;
            end
        end
    end

    always @* begin
        rdata = 32'd0;
        case (raddr)
            DMACR:   rdata = {delay, threshold, 1'b0, enable, 9'd0, resetting, 1'b1, run};
            DMASR:   rdata = {8'd0, threshold, 1'b0, err, 1'b0, ioc, 5'd0, errors, 2'b00, idle, state == HALTED};
            ADDRESS: rdata = address;
            LENGTH:  rdata[LENGTH_BITS-1:0] = length;
            default: ;
        endcase
    end

    wire unused = &{1'b0, wdata};
endmodule

`default_nettype wire
