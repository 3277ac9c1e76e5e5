# SPDX-License-Identifier: MIT
SUMMARY = "Users and groups of Debian, for the class useradd"
LICENSE = "MIT"
LIC_FILES_CHKSUM = ""
INHIBIT_DEFAULT_DEPS = "1"
do_compile[noexec] = "1"
do_configure[noexec] = "1"
do_install() {
    install -d ${D}${sysconfdir}
    install -m 0644 /usr/share/base-passwd/passwd.master ${D}${sysconfdir}/passwd
    install -m 0644 /usr/share/base-passwd/group.master ${D}${sysconfdir}/group
}
SYSROOT_DIRS += "${sysconfdir}"
