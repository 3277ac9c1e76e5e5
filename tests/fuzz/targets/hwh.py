# SPDX-License-Identifier: Apache-2.0
"""Vivado's .hwh: a design, or HwhError; what is asked of a design is answered or refused with HwhError."""

from __future__ import annotations

from contextlib import suppress

from cm.formats import hwh

PACKAGES = ("cm.formats.hwh",)
MAX_LENGTH = 16384

_DESIGN = b"""<?xml version="1.0" encoding="UTF-8"?>
<EDKSYSTEM EDWVERSION="1.2" TIMESTAMP="Mon Jan  3 10:00:00 2022" VIVADOVERSION="2022.1">
  <SYSTEMINFO ARCH="zynq" DEVICE="7z020" NAME="camera" PACKAGE="clg400" SPEEDGRADE="-1"/>
  <EXTERNALPORTS><PORT DIR="O" NAME="led" SIGNAME="gpio_led"/></EXTERNALPORTS>
  <MODULES>
    <MODULE FULLNAME="/ps" INSTANCE="ps" MODCLASS="PROCESSOR" MODTYPE="processing_system7">
      <PARAMETERS><PARAMETER NAME="PCW_FPGA0_PERIPHERAL_FREQMHZ" VALUE="100"/></PARAMETERS>
      <PORTS><PORT DIR="O" NAME="FCLK_CLK0" SIGNAME="clk"/></PORTS>
      <MEMORYMAP>
        <MEMRANGE ADDRESSBLOCK="S_AXI_LITE" BASENAME="C_BASEADDR" BASEVALUE="0x40400000" HIGHVALUE="0x4040FFFF"
          INSTANCE="dma" MASTERBUSINTERFACE="M_AXI_GP0" MEMTYPE="REGISTER" SLAVEBUSINTERFACE="S_AXI_LITE"/>
      </MEMORYMAP>
    </MODULE>
    <MODULE FULLNAME="/dma" INSTANCE="dma" MODTYPE="axi_dma" VLNV="xilinx.com:ip:axi_dma:7.1">
      <PARAMETERS><PARAMETER NAME="c_include_sg" VALUE="0"/></PARAMETERS>
      <ADDRESSBLOCKS>
        <ADDRESSBLOCK ACCESS="" INTERFACE="S_AXI_LITE" NAME="Reg" RANGE="4096" USAGE="register">
          <REGISTERS>
            <REGISTER NAME="MM2S_DMACR">
              <PROPERTY NAME="ADDRESS_OFFSET" VALUE="0"/><PROPERTY NAME="SIZE" VALUE="32"/>
              <FIELDS><FIELD NAME="Run">
                <PROPERTY NAME="BIT_OFFSET" VALUE="0"/><PROPERTY NAME="BIT_WIDTH" VALUE="1"/>
              </FIELD></FIELDS>
            </REGISTER>
          </REGISTERS>
        </ADDRESSBLOCK>
      </ADDRESSBLOCKS>
      <PORTS><PORT DIR="I" NAME="s_axi_lite_aclk" SIGNAME="clk">
        <CONNECTIONS><CONNECTION INSTANCE="ps" PORT="FCLK_CLK0"/></CONNECTIONS></PORT></PORTS>
    </MODULE>
  </MODULES>
</EDKSYSTEM>
"""


def seeds() -> list[bytes]:
    return [_DESIGN]


def one(data: bytes) -> None:
    try:
        design = hwh.parse(data)
    except hwh.HwhError as error:
        str(error)
        return
    with suppress(hwh.HwhError):
        hwh.clocks(design)
    with suppress(hwh.HwhError):
        hwh.interrupts(design)
