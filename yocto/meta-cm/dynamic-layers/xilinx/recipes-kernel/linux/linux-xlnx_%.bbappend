# SPDX-License-Identifier: MIT
# Zynq-7000, Zynq UltraScale+ and Kria (whose machines are zynqmp, too)
FILESEXTRAPATHS:prepend:zynq := "${THISDIR}/linux-xlnx:"
FILESEXTRAPATHS:prepend:zynqmp := "${THISDIR}/linux-xlnx:"

SRC_URI:append:zynq = " file://cm.cfg"
SRC_URI:append:zynqmp = " file://cm.cfg"
