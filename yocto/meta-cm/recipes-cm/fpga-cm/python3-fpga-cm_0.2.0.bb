# SPDX-License-Identifier: MIT
SUMMARY = "Configuration manager for adaptive FPGA systems"
DESCRIPTION = "The daemon and its service; client library, simulated board, build tool and benchmarks are separate packages."
SECTION = "devel/python"
LICENSE = "Apache-2.0"
LIC_FILES_CHKSUM = "file://LICENSE;md5=3b83ef96387f14655fc854ddc3c6bd57"
CVE_PRODUCT = "fpga-cm"
DEPENDS = "protobuf-native python3-cffi-native python3-fastjsonschema-native python3-pyyaml-native"

SRC_URI = "file://fpga_cm-${PV}.tar.gz \
           file://run-ptest \
           file://test_installed.py"

S = "${UNPACKDIR}/fpga_cm-${PV}"

inherit python_setuptools_build_meta ptest systemd update-rc.d useradd

PACKAGE_BEFORE_PN = "${PN}-client ${PN}-sim ${PN}-build ${PN}-bench ${PN}-web ${PN}-bridge ${PN}-udev"

SYSTEMD_PACKAGES = "${PN} ${PN}-bridge"
SYSTEMD_SERVICE:${PN} = "cm.service"
SYSTEMD_SERVICE:${PN}-bridge = "cm-bridge@.service cm-bridge-reload.path cm-record.service"
SYSTEMD_AUTO_ENABLE:${PN}-bridge = "disable"
INITSCRIPT_NAME = "cm"
INITSCRIPT_PARAMS = "defaults 80"
INITSCRIPT_PACKAGES = "${PN}"

USERADD_PACKAGES = "${PN} ${PN}-bridge ${PN}-udev"
GROUPADD_PARAM:${PN} = "--system fpga"
USERADD_PARAM:${PN} = "--system --no-create-home --home-dir ${localstatedir}/lib/cm --shell /sbin/nologin \
                       --user-group --groups fpga cm"
GROUPADD_PARAM:${PN}-bridge = "--system fpga"
USERADD_PARAM:${PN}-bridge = "--system --no-create-home --home-dir ${localstatedir}/lib/cm-bridge --shell /sbin/nologin \
                              --user-group --groups fpga cm-bridge"
GROUPADD_PARAM:${PN}-udev = "--system fpga"

do_install:append:class-target() {
    if ${@bb.utils.contains('DISTRO_FEATURES', 'systemd', 'true', 'false', d)}; then
        install -D -m 0644 ${S}/system/systemd/cm.service ${D}${systemd_system_unitdir}/cm.service
        for unit in cm-bridge@.service cm-bridge-reload.path cm-bridge-reload.service cm-record.service; do
            install -m 0644 ${S}/system/systemd/$unit ${D}${systemd_system_unitdir}/
        done
        install -D -m 0644 ${S}/system/tmpfiles.d/cm.conf ${D}${nonarch_libdir}/tmpfiles.d/cm.conf
    else
        install -D -m 0755 ${S}/system/sysv/cm ${D}${sysconfdir}/init.d/cm
    fi
    install -D -m 0644 ${S}/system/completion/cm ${D}${datadir}/bash-completion/completions/cm
    install -D -m 0644 ${S}/system/cm.yaml ${D}${sysconfdir}/cm/cm.yaml
    install -m 0644 ${S}/system/bridge-ros.conf ${S}/system/bridge-fleet.conf ${D}${sysconfdir}/cm/
    install -d ${D}${sysconfdir}/cm/configs
    install -d -o cm -g fpga -m 0700 ${D}${sysconfdir}/cm/keys
    install -d ${D}${nonarch_base_libdir}/firmware/cm
    install -d -o cm -g fpga ${D}${nonarch_base_libdir}/firmware/cm-converted
    install -D -m 0644 ${S}/system/udev/60-cm.rules ${D}${nonarch_base_libdir}/udev/rules.d/60-cm.rules
    install -D -m 0644 ${S}/system/modprobe.d/cm.conf ${D}${nonarch_base_libdir}/modprobe.d/cm.conf
}

do_install_ptest() {
    install -m 0644 ${UNPACKDIR}/test_installed.py ${D}${PTEST_PATH}/
}

CM = "${PYTHON_SITEPACKAGES_DIR}/cm"
FILES:${PN}-client += "${bindir}/cm ${datadir}/bash-completion ${PYTHON_SITEPACKAGES_DIR}/*.dist-info ${CM}/*.py ${CM}/py.typed \
                       ${CM}/cli ${CM}/client ${CM}/device ${CM}/wire"
FILES:${PN}-sim += "${CM}/data ${CM}/simulation ${CM}/tools/demo"
FILES:${PN}-web += "${CM}/web"
FILES:${PN}-bridge += "${CM}/networks \
                       ${systemd_system_unitdir}/cm-bridge* ${sysconfdir}/cm/bridge-*.conf"
FILES:${PN}-build += "${CM}/design"
FILES:${PN}-bench += "${CM}/tools/bench"
FILES:${PN}-udev += "${nonarch_base_libdir}/udev ${nonarch_base_libdir}/modprobe.d"
FILES:${PN} += "${nonarch_base_libdir}/firmware ${nonarch_libdir}/tmpfiles.d"
CONFFILES:${PN} = "${sysconfdir}/cm/cm.yaml"
CONFFILES:${PN}-bridge = "${sysconfdir}/cm/bridge-ros.conf ${sysconfdir}/cm/bridge-fleet.conf"

# What the modules of each package import, as a test verifies. The native variant needs none of it.
CM_NEEDS_CLIENT = "python3-asyncio \
                   python3-cffi \
                   python3-core \
                   python3-crypt \
                   python3-difflib \
                   python3-fcntl \
                   python3-html \
                   python3-io \
                   python3-json \
                   python3-logging \
                   python3-mmap \
                   python3-numpy \
                   python3-protobuf \
                   python3-pyzmq \
                   python3-statistics \
                   python3-threading"
CM_NEEDS_DAEMON = "python3-compression \
                   python3-datetime \
                   python3-fastjsonschema \
                   python3-netclient \
                   python3-pyyaml \
                   python3-resource \
                   python3-xml"
# the script for an older init gives the manager its user and its one capability with setpriv
CM_NEEDS_INIT = "${@bb.utils.contains('DISTRO_FEATURES', 'systemd', '', 'util-linux-setpriv', d)}"
RDEPENDS:${PN}-client:append:class-target = " ${CM_NEEDS_CLIENT}"
RDEPENDS:${PN}:append:class-target = " ${PN}-client (= ${EXTENDPKGV}) ${CM_NEEDS_DAEMON} ${CM_NEEDS_INIT}"
RDEPENDS:${PN}-sim:append:class-target = " ${PN} (= ${EXTENDPKGV})"
RDEPENDS:${PN}-build:append:class-target = " ${PN}-sim (= ${EXTENDPKGV}) python3-jinja2 python3-shell"
RDEPENDS:${PN}-bench:append:class-target = " ${PN}-sim (= ${EXTENDPKGV}) python3-shell"
RDEPENDS:${PN}-web:append:class-target = " ${PN}-client (= ${EXTENDPKGV}) python3-aiohttp python3-netclient"
RDEPENDS:${PN}-bridge:append:class-target = " ${PN} (= ${EXTENDPKGV}) python3-datetime python3-netclient python3-sqlite3"
RDEPENDS:${PN}-ptest += "${PN}-sim python3-pytest python3-unittest-automake-output"
RRECOMMENDS:${PN}-client:append:class-target = " python3-argcomplete"
RRECOMMENDS:${PN}-sim:append:class-target = " python3-pillow"
RRECOMMENDS:${PN}-web:append:class-target = " python3-pillow"
RRECOMMENDS:${PN}:append:class-target = " ${PN}-udev python3-cryptography kernel-module-cm-dma kernel-module-cm-icap kernel-module-cm-overlay"

BBCLASSEXTEND = "native"
