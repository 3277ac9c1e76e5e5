# SPDX-License-Identifier: Apache-2.0
"""The root file system: Python and our dependencies from Debian's packages, busybox, nothing else.

Nothing of the foreign architecture is run while it is made; what maintainer scripts would do is done here by hand.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

from vmboard.arch import Arch, host
from vmboard.cache import Cache
from vmboard.packages import Apt, unpack
from vmboard.shell import require, run

PACKAGES = [
    "python3",
    "python3-yaml",
    "python3-numpy",
    "python3-zmq",
    "python3-protobuf",
    "python3-cffi-backend",
    "python3-fastjsonschema",
    "python3-pil",
    "python3-pytest",
    "python3-pytest-timeout",
    "busybox-static",
]
APPLETS = (
    "sh ash cat cp ln ls mkdir mknod mount mv rm rmdir sleep sync umount uname echo grep sed tar dmesg kill pidof ps "
    "ip ifconfig route hostname poweroff reboot insmod lsmod modprobe rmmod depmod switch_root setsid cttyhack "
    "stty vi less more head tail find wc cut sort tr touch test true false date df du free top env id chmod "
    "hexdump xxd od printf seq readlink dirname basename watch stat timeout nc ping usleep clear"
)
DROP = (
    "usr/share/doc",
    "usr/share/man",
    "usr/share/locale",
    "usr/share/info",
    "usr/share/perl5",
    "usr/lib/python3/dist-packages/numpy/f2py",
)
SIZE = "1G"  # a power of two: an SD card of another size is none to QEMU
LAYOUT = "2"
ETC = {
    "passwd": "root:x:0:0:root:/root:/bin/sh\nnobody:x:65534:65534:nobody:/:/bin/false\n",
    "group": "root:x:0:\nnogroup:x:65534:\n",
    "hosts": "127.0.0.1 localhost\n",
    "hostname": "cm-board\n",
    "nsswitch.conf": "passwd: files\ngroup: files\nhosts: files\n",
}
INIT = Path(__file__).resolve().parents[1] / "guest/init"


def image(cache: Cache, arch: Arch) -> Path:
    """The ext4 image of the root file system; boot it with snapshot=on, it is shared."""
    require("mke2fs")
    inputs = [LAYOUT, arch.debian, *PACKAGES, APPLETS, *DROP, SIZE, INIT]
    place = cache.entry(f"rootfs-{arch.debian}", inputs, lambda out: _build(cache, arch, out))
    return place / "root.ext4"


def headers(cache: Cache, arch: Arch) -> Path:
    """The folder to compile Python extensions against: usr/include/python3.x of that architecture."""

    def build(out: Path) -> None:
        debs = Apt(cache.root, arch, arch.suite).download([f"libpython{arch.python}-dev"], out / "debs")
        unpack(debs, out / "root")

    return cache.entry(f"python-headers-{arch.debian}", [LAYOUT, arch.debian], build) / "root/usr/include"


def _build(cache: Cache, arch: Arch, place: Path) -> None:
    root = place / "root"
    unpack(Apt(cache.root, arch, arch.suite).closure(PACKAGES, place / "debs"), root)
    (place / "packages.txt").write_text("".join(f"{deb.name}\n" for deb in sorted((place / "debs").glob("*.deb"))))
    _configure(root, arch)
    for name in DROP:
        shutil.rmtree(root / name, ignore_errors=True)
    compile_python(cache, arch, root, f"usr/lib/python{arch.python}", "usr/lib/python3/dist-packages")
    run(["mke2fs", "-q", "-t", "ext4", "-O", "^has_journal", "-L", "cm-root", "-d", root, place / "root.ext4", SIZE])
    shutil.rmtree(root)
    shutil.rmtree(place / "debs")


def _configure(root: Path, arch: Arch) -> None:
    for folder in ("dev", "proc", "sys", "run", "tmp", "root", "mnt", "opt/cm", "var/lib", "var/tmp", "lib/firmware"):
        (root / folder).mkdir(parents=True, exist_ok=True)
    for name, text in ETC.items():
        (root / "etc" / name).write_text(text)
    for applet in APPLETS.split():
        link = root / "usr/bin" / applet
        if not link.exists():
            link.symlink_to("busybox")
    libraries = root / "usr/lib" / arch.gnu
    for name in ("blas", "lapack"):  # update-alternatives would
        link = libraries / f"lib{name}.so.3"
        if not link.exists():
            link.symlink_to(f"{name}/lib{name}.so.3")
    shutil.copy2(INIT, root / "usr/sbin/cm-init")


def compile_python(cache: Cache, arch: Arch, root: Path, *folders: str, place: str = "/") -> None:
    """Byte code spares an emulated processor most of a start; it is that of the board's own Python.

    `folders` lie below `root`, which is `place` on the board.
    """
    if arch.python == ".".join(map(str, sys.version_info[:2])):
        interpreter = [sys.executable]
    else:
        interpreter = _python(cache, arch)
    options = ["-q", "-q", "-s", root, "-p", place]
    run([*interpreter, "-m", "compileall", *options, *(root / folder for folder in folders)])


def _python(cache: Cache, arch: Arch) -> list[str | Path]:
    """The release's Python for this machine, through its own C library."""

    def fetch(out: Path) -> None:
        unpack(Apt(cache.root, host(), arch.suite).closure(["python3-minimal", "python3"], out / "debs"), out / "root")
        shutil.rmtree(out / "debs")

    tree = cache.entry(f"python-host-{arch.suite}", [arch.suite, arch.python], fetch) / "root"
    libraries = tree / "usr/lib" / host().gnu
    loader = next(libraries.glob("ld-linux*.so.*"))
    return [loader, "--library-path", libraries, tree / f"usr/bin/python{arch.python}"]
