# SPDX-License-Identifier: Apache-2.0
"""A whole Debian for a board: installed by Debian's own dpkg, on the board itself, from packages that lie on a disk.

The host only downloads and extracts (so neither root nor programs of the foreign architecture are needed); then the
board boots once, with `guest/bootstrap` as its first process, and dpkg unpacks and configures everything over it.
"""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

from vmboard import initrd, qemu
from vmboard.arch import Arch
from vmboard.cache import Cache
from vmboard.errors import VmError
from vmboard.kernel import Kernel
from vmboard.packages import Apt, inflated, unpack
from vmboard.paths import REPOSITORY
from vmboard.payload import copy_modules
from vmboard.progress import say
from vmboard.shell import run

GUEST = REPOSITORY / "tests/vm/guest"
PACKAGES = (
    "?essential",
    "adduser",
    "apt",
    "busybox-static",
    "dbus",
    "dkms",
    "gcc",
    "iproute2",
    "kmod",
    "libc6-dev",
    "make",
    "python3-cffi-backend",
    "python3-cryptography",
    "python3-fastjsonschema",
    "python3-numpy",
    "python3-pil",
    "python3-pip",
    "python3-protobuf",
    "python3-yaml",
    "python3-zmq",
    "qemu-guest-agent",
    "sudo",
    "systemd-sysv",
    "udev",
)
# What systemd and the board use once the root file system is there; drivers of disks are in the initramfs.
DRIVERS = (
    *("autofs4", "configfs", "ipv6", "rtc_pl031", "uio", "uio_pdrv_genirq"),
    *("virtio_console", "virtio_net", "virtio_rng"),
)
SIZE = "3G"
BOOTSTRAP_S = 3600.0  # a machine that is busy with other things takes its time
DONE = b"cm-board: done"


@dataclass(frozen=True, slots=True)
class System:
    """A root file system with the kernel that it was made for."""

    kernel: Kernel
    root: Path  # ext4 image, never written to

    @property
    def folder(self) -> Path:
        """Where it lies; another system made from it names this among its inputs."""
        return self.root.parent


def system(cache: Cache, arch: Arch) -> System:
    """Debian with all that our packages need, and without them."""
    place = cache.entry(
        f"debian-{arch.label}",
        [arch.label, *PACKAGES, *DRIVERS, SIZE, GUEST / "bootstrap", GUEST / "bootstrap.files"],
        lambda out: _build(cache, arch, out),
    )
    return System(_kernel(arch, place), place / "root.ext4")


def _kernel(arch: Arch, place: Path) -> Kernel:
    release = (place / "release").read_text()
    image = next((place / "kernel/boot").glob("vmlinuz-*"))
    return Kernel(release, arch, image, place / "kernel", place / "kernel", "")


def _build(cache: Cache, arch: Arch, place: Path) -> None:
    apt = Apt(cache.root, arch, arch.suite)
    flavour = arch.kernel_flavour
    package = apt.depends_like(f"linux-image-{flavour}", rf"linux-image-[0-9][^ ]*-{flavour}")
    release = package.removeprefix("linux-image-")
    (place / "release").write_text(release)
    unpack(apt.download([package], place / "image"), place / "kernel")
    run(["depmod", "-b", place / "kernel", release])
    debs = apt.closure([*PACKAGES, f"linux-headers-{release}"], place / "debs")
    (place / "packages.txt").write_text("".join(f"{deb.name}\n" for deb in debs))
    root = place / "root"
    unpack(debs, root)
    copy_modules(root, _kernel(arch, place), DRIVERS)
    _first_files(root)
    run(["mke2fs", "-q", "-t", "ext4", "-L", "cm-root", "-d", root, place / "root.ext4", SIZE])
    (place / "inflated").mkdir()
    for deb in debs:
        inflated(deb, place / "inflated" / deb.name)
    run(["mke2fs", "-q", "-t", "ext4", "-O", "^has_journal", "-d", place / "inflated", place / "debs.ext4", "2G"])
    shutil.rmtree(root)
    change(cache, System(_kernel(arch, place), place / "root.ext4"), place / "debs.ext4", "/bootstrap", place)
    for folder in ("debs", "inflated", "image"):
        shutil.rmtree(place / folder)
    (place / "debs.ext4").unlink()


def _first_files(root: Path) -> None:
    """What there must be before dpkg has run once."""
    for folder in ("proc", "sys", "dev", "run", "tmp", "mnt", "opt/cm", "etc/dpkg/dpkg.cfg.d"):
        (root / folder).mkdir(parents=True, exist_ok=True)
    for name in ("passwd", "group"):
        shutil.copy2(root / f"usr/share/base-passwd/{name}.master", root / "etc" / name)
    for link, target in (("sh", "dash"), ("awk", "mawk")):
        if not (root / "usr/bin" / link).is_symlink():
            (root / "usr/bin" / link).symlink_to(target)
    shutil.copytree(GUEST / "bootstrap.files", root, dirs_exist_ok=True)
    shutil.copy2(GUEST / "bootstrap", root / "bootstrap")


def change(cache: Cache, system: System, disk: Path, init: str, place: Path) -> None:
    """Boot the system with `init` as its only process, its root disk written to; what it says goes to `place`.

    Raises VmError unless the process said that it is done and switched the board off.
    """
    board = qemu.Machine(
        arch=system.kernel.arch,
        image=system.kernel.image,
        root=system.root,
        payload=disk,
        memory_mb=1024,
        initrd=initrd.image(cache, system.kernel),
        keep=True,
        init=init,
        cpus=4,
        budget_s=BOOTSTRAP_S,
    )
    done = qemu.run(board, place, lambda line: say(f"  {line}"))
    console = done.console.read_bytes()
    if DONE not in console:
        end = "\n".join(console.decode(errors="replace").splitlines()[-30:])
        raise VmError(f"{init} on {system.kernel.arch.label} did not come to its end, see {done.console}:\n{end}")
