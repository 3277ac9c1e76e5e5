// SPDX-License-Identifier: Apache-2.0
//
// What the write half of the slave decoupler promises a region, whatever master and region do within the rules.
// With STRICT the region's slave takes address and data in one clock or not at all, as some do.
`default_nettype none

module formal_write_decoupler (
    input wire       clk,
    input wire       resetn,
    input wire       s_awvalid,
    input wire [3:0] s_awpayload,
    input wire       s_wvalid,
    input wire       s_wlast,
    input wire [3:0] s_wpayload,
    input wire       s_bready,
    input wire       free_awready,
    input wire       free_wready,
    input wire       free_bvalid
);
    wire s_awready, s_wready, s_bvalid, m_awvalid, m_wvalid, m_wlast, m_bready, expired, active;
    wire [1:0] s_bresp;
    wire [3:0] m_awpayload, m_wpayload;
`ifdef STRICT
    reg  answer;
    wire both = m_awvalid && m_wvalid;
    wire m_awready = both, m_wready = both, m_bvalid = answer;
    always @(posedge clk) answer <= resetn && (both || (answer && !m_bready));
`else
    wire m_awready = free_awready, m_wready = free_wready, m_bvalid = free_bvalid;
`endif

    cm_axi_slave_decoupler_write #(.AW_WIDTH(4), .W_WIDTH(4), .ID_WIDTH(1)) dut (
        .clk(clk), .resetn(resetn), .decouple(1'b0), .blocked(1'b0), .active(active), .expired(expired),
        .s_awvalid(s_awvalid), .s_awready(s_awready), .s_awpayload(s_awpayload), .s_awlen(8'd0), .s_awid(1'b0),
        .s_wvalid(s_wvalid), .s_wready(s_wready), .s_wlast(s_wlast), .s_wpayload(s_wpayload),
        .s_bvalid(s_bvalid), .s_bready(s_bready), .s_bresp(s_bresp), .s_bid(),
        .m_awvalid(m_awvalid), .m_awready(m_awready), .m_awpayload(m_awpayload), .m_awlen(), .m_awid(),
        .m_wvalid(m_wvalid), .m_wready(m_wready), .m_wlast(m_wlast), .m_wpayload(m_wpayload),
        .m_bvalid(m_bvalid), .m_bready(m_bready), .m_bresp(2'b00)
    );

    reg       begun = 1'b0;  // there is a clock before this one
    reg       address_taken = 1'b0;
    reg [3:0] waited = 4'd0;
    always @(posedge clk) begin
        begun <= 1'b1;
        address_taken <= resetn && (address_taken || (m_awvalid && m_awready)) && !(s_bvalid && s_bready);
        waited <= (resetn && s_awvalid && s_wvalid && !s_bvalid) ? waited + 4'd1 : 4'd0;
        if (begun && $past(resetn) && resetn) begin
            // the master keeps to the rules
            if ($past(s_awvalid && !s_awready)) assume (s_awvalid && s_awpayload == $past(s_awpayload));
            if ($past(s_wvalid && !s_wready)) assume (s_wvalid && s_wlast && s_wpayload == $past(s_wpayload));
            // what was offered stays
            if ($past(m_awvalid && !m_awready)) assert (m_awvalid && m_awpayload == $past(m_awpayload));
            if ($past(m_wvalid && !m_wready)) assert (m_wvalid && m_wlast == $past(m_wlast) && m_wpayload == $past(m_wpayload));
            // address and first beat begin in one clock: neither comes alone
            if (m_awvalid && !$past(m_awvalid)) assert (m_wvalid && !$past(m_wvalid));
            if (m_wvalid) assert (m_awvalid || address_taken);
            if (!active) assert (!m_awvalid && !m_wvalid);
`ifdef STRICT
            assert (waited < 4'd8);  // a write that is offered is answered
`endif
        end
        assume (s_wlast);  // AXI4-Lite, and bursts of one beat
    end
endmodule

`default_nettype wire
