# SPDX-License-Identifier: MIT
SUMMARY = "Nothing in the place of shadow-sysroot"
LICENSE = "MIT"
LIC_FILES_CHKSUM = ""
INHIBIT_DEFAULT_DEPS = "1"
DEPENDS = ""
do_install[noexec] = "1"
do_compile[noexec] = "1"
do_configure[noexec] = "1"
