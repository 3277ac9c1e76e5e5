# SPDX-License-Identifier: MIT
SUMMARY = "Device-tree overlays of the configuration manager's examples"
DESCRIPTION = "Also for boards whose trees have no symbols: targets are given by path, or by labels of the base tree."
SECTION = "bsp"
LICENSE = "(GPL-2.0-only | BSD-2-Clause) & Apache-2.0"
LIC_FILES_CHKSUM = "file://LICENSES/GPL-2.0-only.txt;md5=b234ee4d69f5fce4486a80fdaf4a4263 \
                    file://LICENSES/BSD-2-Clause.txt;md5=d0f280d1058e77e66264a9b9e10e6c89 \
                    file://LICENSE;md5=3b83ef96387f14655fc854ddc3c6bd57"
CVE_PRODUCT = "fpga-cm"
DEPENDS = "dtc-native"

SRC_URI = "file://fpga_cm-${PV}.tar.gz"

S = "${UNPACKDIR}/fpga_cm-${PV}"
B = "${WORKDIR}/build"

inherit allarch

do_configure[noexec] = "1"

# the build host's preprocessor: these files contain nothing that depends on the target
do_compile() {
    oe_runmake -C ${S}/dts O=${B} CPP="${BUILD_CPP}" dtbo
}

do_install() {
    install -d ${D}${nonarch_base_libdir}/firmware/cm-overlays
    for folder in ${B}/plain/*/; do
        install -d ${D}${nonarch_base_libdir}/firmware/cm-overlays/$(basename $folder)
        install -m 0644 $folder/*.dtbo ${D}${nonarch_base_libdir}/firmware/cm-overlays/$(basename $folder)/
    done
}

FILES:${PN} += "${nonarch_base_libdir}/firmware/cm-overlays"
