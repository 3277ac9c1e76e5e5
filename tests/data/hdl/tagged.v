// SPDX-License-Identifier: Apache-2.0
// Ports whose names tell nothing: the attributes do, in non-ANSI style and with the spellings that are met.
module tagged (ck, nclr, d, dv, dr, a_ready, a_valid, a_data, ev, probe_tdata, probe_tvalid, probe_tready, spare_tdata,
               spare_tvalid, sda_o);
    parameter WIDTH = 16;
    (* X_INTERFACE_INFO = "xilinx.com:signal:clock:1.0 core_clock CLK" *)
    (* X_INTERFACE_PARAMETER = "XIL_INTERFACENAME core_clock, ASSOCIATED_BUSIF pixels_in:pixels_out, ASSOCIATED_RESET nclr, FREQ_HZ 100000000" *)
    input ck;
    (* x_interface_info = "xilinx.com:signal:reset:1.0 clear RST", x_interface_parameter = "POLARITY ACTIVE_LOW" *)
    input nclr;
    (* X_INTERFACE_INFO = "xilinx.com:interface:axis:1.0 pixels_in TDATA" *)
    input [WIDTH-1:0] d;
    (* X_INTERFACE_INFO = "xilinx.com:interface:axis:1.0 pixels_in TVALID" *)
    input dv;
    (* X_INTERFACE_INFO = "xilinx.com:interface:axis:1.0 pixels_in TREADY" *)
    output dr;
    (* X_INTERFACE_INFO = "xilinx.com:interface:axis:1.0 pixels_out TREADY" *)
    input a_ready;
    (* X_INTERFACE_INFO = "xilinx.com:interface:axis:1.0 pixels_out TVALID" *)
    output a_valid;
    (* X_INTERFACE_INFO = "xilinx.com:interface:axis:1.0 pixels_out TDATA" *)
    output reg [WIDTH-1:0] a_data;
    (* X_INTERFACE_INFO = "xilinx.com:signal:interrupt:1.0 event INTERRUPT" *)
    (* X_INTERFACE_PARAMETER = "SENSITIVITY EDGE_RISING" *)
    output ev;
    (* X_INTERFACE_MODE = "monitor" *)
    (* X_INTERFACE_INFO = "xilinx.com:interface:axis:1.0 probe TDATA" *)
    input [WIDTH-1:0] probe_tdata;
    (* X_INTERFACE_INFO = "xilinx.com:interface:axis:1.0 probe TVALID" *)
    input probe_tvalid;
    (* X_INTERFACE_INFO = "xilinx.com:interface:axis:1.0 probe TREADY" *)
    input probe_tready;
    (* X_INTERFACE_IGNORE = "true" *)
    input [7:0] spare_tdata;
    (* X_INTERFACE_IGNORE = "true" *)
    input spare_tvalid;
    (* X_INTERFACE_INFO = "xilinx.com:interface:iic:1.0 sensor SDA_O" *)
    output sda_o;
endmodule
