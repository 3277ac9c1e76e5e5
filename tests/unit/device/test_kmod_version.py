# SPDX-License-Identifier: Apache-2.0
"""The kernel modules are of the same version as the package."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from cm._version import __version__

ROOT = Path(__file__).parents[3]
KMOD = ROOT / "kmod"
DKMS = (KMOD / "dkms.conf", *sorted((ROOT / "debian").glob("*.dkms")))
MODULES = re.findall(r"^CM_MODULES \?= (.*)$", (KMOD / "Kbuild").read_text(), re.MULTILINE)[0].split()


def test_version_of_the_headers() -> None:
    said = re.search(r'#define CM_VERSION "(.*)"', (KMOD / "include/cm_compat.h").read_text())
    assert said is not None
    assert said[1] == __version__


def test_version_of_dkms() -> None:
    said = re.search(r'PACKAGE_VERSION="(.*)"', (KMOD / "dkms.conf").read_text())
    assert said is not None
    assert said[1] == __version__


def test_each_module_but_the_simulator_is_of_one_package() -> None:
    named = [re.findall(r'BUILT_MODULE_NAME\[\d\]="(\w+)"', path.read_text()) for path in DKMS]
    assert sorted(name for names in named for name in names) == sorted(MODULES)
    assert named[0] == ["cm_dma", "cm_icap", "cm_window", "cm_intc"]


@pytest.mark.parametrize(
    ("release", "taken"),
    [("5.15.0", True), ("6.12.1", True), ("10.0", True), ("5.10.0-32-arm64", False), ("4.19.0", False)],
)
def test_dkms_leaves_out_kernels_that_are_too_old(release: str, taken: bool) -> None:
    (pattern,) = re.findall(r'BUILD_EXCLUSIVE_KERNEL="(.*)"', (KMOD / "dkms.conf").read_text())
    assert bool(re.match(pattern, release)) == taken


@pytest.mark.parametrize("module", [*MODULES, "cm_plsim"])
def test_each_module_says_its_version(module: str) -> None:
    folder = {"cm_dma": "core", "cm_axidma_compat": "axidma"}.get(module, module.removeprefix("cm_"))
    sources = (KMOD / folder).glob("*.c")
    assert sum("MODULE_VERSION(CM_VERSION)" in source.read_text() for source in sources) == 1
