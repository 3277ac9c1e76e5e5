# SPDX-License-Identifier: Apache-2.0
"""The processor architectures the board comes in, and what each is called where."""

from __future__ import annotations

import platform
from dataclasses import dataclass, replace


@dataclass(frozen=True, slots=True)
class Arch:
    """Names of one architecture."""

    debian: str  # as packages are labelled
    kernel: str  # ARCH= of the kernel's make
    gnu: str  # triplet of the compiler and of the library folder
    machine: str  # as uname -m says
    qemu: str
    image: str  # the kernel's make target
    python: str = "3.11"  # of the release that its packages are of
    suite: str = ""  # that release, where it is not the host's
    flavour: str = ""  # of Debian's kernel, where it is not called as packages are labelled

    @property
    def label(self) -> str:
        """The name of its folders in the cache."""
        return f"{self.debian}-{self.suite}" if self.suite else self.debian

    @property
    def kernel_flavour(self) -> str:
        """The end of the name of Debian's kernel."""
        return self.flavour or self.debian


ARM64 = Arch("arm64", "arm64", "aarch64-linux-gnu", "aarch64", "qemu-system-aarch64", "Image")
ARMHF = Arch("armhf", "arm", "arm-linux-gnueabihf", "armv7l", "qemu-system-arm", "zImage", "3.13", "trixie")
AMD64 = Arch("amd64", "x86_64", "x86_64-linux-gnu", "x86_64", "qemu-system-x86_64", "bzImage")
# with Debian's own kernel, for QEMU's machine "virt"
ARMMP = replace(ARMHF, flavour="armmp")


def host() -> Arch:
    """The architecture this runs on; arm64 or amd64."""
    return ARM64 if platform.machine() == "aarch64" else AMD64


def cross_prefix(arch: Arch) -> str:
    """The prefix of the compiler's name: empty where the host is of that architecture."""
    return "" if arch == host() else f"{arch.gnu}-"
