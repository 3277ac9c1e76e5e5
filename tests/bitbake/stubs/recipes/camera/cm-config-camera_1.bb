# SPDX-License-Identifier: MIT
SUMMARY = "The camera of the virtual board, as cm build generate would write its recipe"
LICENSE = "MIT"
LIC_FILES_CHKSUM = "file://${COMMON_LICENSE_DIR}/MIT;md5=0835ade698e0bcf8506ecda2f7b4f302"
SRC_URI = "file://camera.tar.gz;subdir=${BP}"
CM_CONFIG = "camera"
inherit cm-bundle
