# SPDX-License-Identifier: MIT
SUMMARY = "A small image with the configuration manager, to begin with"
DESCRIPTION = "Boots to a console and ssh, with the service and the kernel modules, and no configuration yet."
SECTION = "images"
LICENSE = "MIT"
CVE_PRODUCT = "fpga-cm"

inherit core-image

IMAGE_FEATURES += "ssh-server-dropbear"
IMAGE_INSTALL += "packagegroup-cm"
