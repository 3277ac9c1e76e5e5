# SPDX-License-Identifier: MIT
# Installs a configuration for the configuration manager: the archive that `cm build collect` wrote.
#
#   SRC_URI = "file://camera.tar.gz;subdir=${BP}"
#   CM_CONFIG = "camera"
#   inherit cm-bundle
#
# The runtime schema is checked with `cm config check`, and every file that it names must be in the archive.

CM_CONFIG ??= "${@d.getVar('BPN').replace('cm-config-', '', 1)}"
S = "${UNPACKDIR}/${BP}"

# a package for all machines cannot depend on the manager, whose package is for one architecture
inherit allarch

DEPENDS += "python3-fpga-cm-native"

do_configure[noexec] = "1"

do_compile() {
    if [ ! -d "${S}/${CM_CONFIG}" ]; then
        bbfatal "the archive has no folder ${CM_CONFIG}: CM_CONFIG names the configuration that cm build collect packed"
    fi
    nativepython3 -m cm config check "${S}/${CM_CONFIG}"
}

do_install() {
    install -d ${D}${nonarch_base_libdir}/firmware/cm/${CM_CONFIG}
    install -m 0644 ${S}/${CM_CONFIG}/* ${D}${nonarch_base_libdir}/firmware/cm/${CM_CONFIG}/
}

FILES:${PN} += "${nonarch_base_libdir}/firmware/cm/${CM_CONFIG}"
