# SPDX-License-Identifier: MIT
SUMMARY = "The configuration manager on a board"
SUMMARY:${PN}-sim = "The configuration manager without hardware: simulated board and simulated PL"
DESCRIPTION = "Daemon, command, rules and kernel modules. The simulated PL and the simulated board are in packagegroup-cm-sim."
SECTION = "base"

# kernel modules are machine-specific packages
PACKAGE_ARCH = "${MACHINE_ARCH}"

inherit packagegroup

PACKAGES = "${PN} ${PN}-sim"

RDEPENDS:${PN} = "kernel-module-cm-clock \
                  kernel-module-cm-dma \
                  kernel-module-cm-icap \
                  kernel-module-cm-intc \
                  kernel-module-cm-overlay \
                  kernel-module-cm-window \
                  python3-fpga-cm \
                  python3-fpga-cm-udev"
RDEPENDS:${PN}-sim = "${PN} \
                      kernel-module-cm-plsim \
                      python3-fpga-cm-sim"
