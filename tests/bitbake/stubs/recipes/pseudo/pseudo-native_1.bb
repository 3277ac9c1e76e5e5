# SPDX-License-Identifier: MIT
SUMMARY = "Debian's pseudo in the place of pseudo-native"
LICENSE = "MIT"
LIC_FILES_CHKSUM = ""
INHIBIT_DEFAULT_DEPS = "1"
DEPENDS = ""
PROVIDES += "virtual/fakeroot-native"
inherit native
do_compile[noexec] = "1"
do_configure[noexec] = "1"
do_install[noexec] = "1"
