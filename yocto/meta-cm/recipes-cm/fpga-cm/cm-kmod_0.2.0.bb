# SPDX-License-Identifier: MIT
SUMMARY = "Kernel modules of the configuration manager"
DESCRIPTION = "Each module has its own package, kernel-module-cm-*; this package is empty and depends on all of them."
SECTION = "kernel/modules"
CVE_PRODUCT = "fpga-cm"
LICENSE = "GPL-2.0-only"
LIC_FILES_CHKSUM = "file://COPYING;md5=b234ee4d69f5fce4486a80fdaf4a4263"

SRC_URI = "file://fpga_cm-${PV}.tar.gz"

S = "${UNPACKDIR}/fpga_cm-${PV}/kmod"

inherit module

# the modules' packages are made only in do_package: declare beforehand that they will exist
PACKAGES_DYNAMIC += "^kernel-module-cm-.*"

MODULES_MODULE_SYMVERS_LOCATION = "."
