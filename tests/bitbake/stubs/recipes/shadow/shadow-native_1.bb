# SPDX-License-Identifier: MIT
SUMMARY = "Debian's shadow in the place of shadow-native"
LICENSE = "MIT"
LIC_FILES_CHKSUM = ""
INHIBIT_DEFAULT_DEPS = "1"
DEPENDS = ""
inherit native
do_compile[noexec] = "1"
do_configure[noexec] = "1"
do_install[noexec] = "1"
