# SPDX-License-Identifier: Apache-2.0
"""Kernels to boot: small ones built from Debian's source, and Debian's own."""

from __future__ import annotations

import os
import re
import shutil
import threading
from dataclasses import dataclass
from pathlib import Path

from vmboard.arch import Arch, cross_prefix, host
from vmboard.cache import Cache
from vmboard.errors import VmError
from vmboard.packages import Apt, unpack
from vmboard.paths import REPOSITORY
from vmboard.progress import say
from vmboard.shell import require, run

FRAGMENTS = REPOSITORY / "tests/vm/kernel"
SOURCE_PACKAGE = "linux-source-6.1"
# Drivers without which the source is half the size; their Kconfig files stay.
UNUSED = ("gpu", "media", "staging", "infiniband", "scsi", "net/wireless", "net/ethernet", "usb", "iio", "hwmon")


@dataclass(frozen=True, slots=True)
class Kernel:
    """A kernel that can be booted and built against."""

    release: str  # as uname -r says
    arch: Arch
    image: Path
    build: Path  # KDIR of modules built for it
    modules: Path  # root below which lib/modules/<release> lies
    prefix: str  # of the compiler's name
    foreign: bool = False  # the compiler that it was built with is not the host's

    def make(self) -> list[str]:
        """The start of a make command line that builds modules for it."""
        return ["make", "-C", str(self.build), f"ARCH={self.arch.kernel}", f"CROSS_COMPILE={self.prefix}"]


def custom(cache: Cache, arch: Arch, fragments: tuple[str, ...]) -> Kernel:
    """The kernel of our own configuration: allnoconfig and the named fragments, the later ones adding."""
    prefix = cross_prefix(arch)
    require("make", "flex", "bison", "bc", f"{prefix}gcc")
    source = cache.entry("linux-source", [SOURCE_PACKAGE, *UNUSED], lambda place: _unpack_source(cache, place))
    config = "".join((FRAGMENTS / name).read_text() for name in fragments)
    kind = "kernel-" + fragments[-1].removesuffix(".config")
    tree = _source_tree(source)
    place = cache.entry(kind, [config, source.name], lambda out: _build(tree, out, arch, config), resume=True)
    release = (place / "include/config/kernel.release").read_text().strip()
    image = place / "arch" / arch.kernel / "boot" / arch.image
    return Kernel(release, arch, image, place, place / "installed", prefix)


def _unpack_source(cache: Cache, place: Path) -> None:
    archives = Apt(cache.root, host()).download([SOURCE_PACKAGE], place / "debs")
    unpack(archives, place / "package")
    excluded = [f"--exclude=*/drivers/{name}/*.[ch]" for name in UNUSED]
    excluded += ["--exclude=*/sound/*.[ch]", "--exclude=*/tools/testing/*", "--exclude=*/Documentation/*.rst"]
    packed = place / "package/usr/src" / f"{SOURCE_PACKAGE}.tar.xz"
    run(["tar", "-x", "-f", packed, "-C", place, *excluded])
    packed.unlink()


def _source_tree(source: Path) -> Path:
    return next(path for path in source.glob("linux-source-*") if path.is_dir())


def _build(tree: Path, out: Path, arch: Arch, config: str) -> None:
    (out / "fragments.config").write_text(config)
    log = out / "build.log"
    # The disk that is installed meanwhile, on one emulated processor, takes longer than all kernels: it goes first.
    base = ["nice", "-n", "10", "make", "-C", tree, f"O={out}", f"ARCH={arch.kernel}"]
    base.append(f"CROSS_COMPILE={cross_prefix(arch)}")
    environment = {
        "KCONFIG_ALLCONFIG": str(out / "fragments.config"),
        "KBUILD_BUILD_TIMESTAMP": "2024-01-01",
        "KBUILD_BUILD_USER": "cm",
        "KBUILD_BUILD_HOST": "vm",
    }
    if not (out / ".config").exists():
        run([*base, "allnoconfig"], log=log, env=environment)
        _check_config(config, out / ".config")
    with _Ticker(log):
        run([*base, f"-j{os.cpu_count() or 1}", arch.image, "modules"], log=log, env=environment)
    run([*base, f"INSTALL_MOD_PATH={out / 'installed'}", "modules_install"], log=log, env=environment)
    _drop_objects(out)


def _check_config(fragment: str, config: Path) -> None:
    """Kconfig drops silently what it cannot set; that must not pass unseen."""
    chosen = set(config.read_text().splitlines())
    wanted: dict[str, str] = {}
    for line in fragment.splitlines():  # a later one counts, one that takes a symbol away too
        if found := re.fullmatch(r"(CONFIG_\w+)=.*|# (CONFIG_\w+) is not set", line):
            wanted[found[1] or found[2]] = line
    dropped = [line for line in wanted.values() if line not in chosen and not line.startswith("#")]
    if dropped:
        config.unlink()
        raise VmError(f"the kernel's configuration does not take: {', '.join(dropped)}")


class _Ticker:
    """Says every half minute how many files of a kernel's build are done."""

    def __init__(self, log: Path) -> None:
        self._log = log
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> None:
        self._thread.start()

    def __exit__(self, *_: object) -> None:
        self._done.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._done.wait(30):
            compiled = len(re.findall(r"^  (?:CC|AS) ", self._log.read_text(errors="replace"), re.MULTILINE))
            say(f"  kernel: {compiled} files compiled")


def _drop_objects(out: Path) -> None:
    """Remove what a build of modules does not need: most of the size."""
    kept = {out / "scripts", out / "installed"}
    for path in out.rglob("*"):
        if kept.isdisjoint(path.parents) and path.is_file() and _is_object(path.name):
            path.unlink()


def _is_object(name: str) -> bool:
    return name.endswith((".o", ".a", ".cmd")) or name.startswith("vmlinux")


def stock(cache: Cache, arch: Arch, suite: str = "") -> Kernel:
    """Debian's own kernel, with its headers: of the running release, or of another suite."""
    if suite:
        return _of_suite(cache, arch, suite)
    foreign = Apt(cache.root, arch)
    meta = f"linux-image-{arch.debian}"
    place = cache.entry(
        f"kernel-stock-{arch.debian}", [meta, "layout 1"], lambda out: _fetch_stock(cache, foreign, meta, out)
    )
    release = (place / "release").read_text()
    image = next((place / "root/boot").glob("vmlinuz-*"))
    build = place / "root/usr/src" / f"linux-headers-{release}"
    return Kernel(release, arch, image, build, place / "root", cross_prefix(arch))


def _fetch_stock(cache: Cache, foreign: Apt, meta: str, place: Path) -> None:
    pattern = rf"linux-image-[0-9][^ ]*-{foreign.arch.debian}"
    release = foreign.depends_like(meta, pattern).removeprefix("linux-image-")
    common = f"linux-headers-{release.removesuffix(foreign.arch.debian)}common"
    debs = foreign.download([f"linux-image-{release}", f"linux-headers-{release}", common], place / "debs")
    # kbuild's programs run on the host, whatever the kernel is for
    kbuild = Apt(cache.root, host()).download([_kbuild(release)], place / "kbuild")
    unpack([*debs, *kbuild], place / "root")
    _point_headers_home(place / "root/usr/src")
    for folder in ("debs", "kbuild"):
        for deb in (place / folder).glob("*.deb"):
            deb.unlink()
    run(["depmod", "-b", place / "root", release])
    (place / "release").write_text(release)


def _kbuild(release: str) -> str:
    return "linux-kbuild-" + ".".join(release.split(".")[:2])


def _point_headers_home(sources: Path) -> None:
    """The packaged Makefiles name /usr/src; here the headers lie in the cache."""
    for makefile in sources.glob("linux-headers-*/Makefile"):
        text = makefile.read_text()
        if "include /usr/src/" in text:
            makefile.write_text(text.replace("/usr/src/", f"{sources}/"))


def _of_suite(cache: Cache, arch: Arch, suite: str) -> Kernel:
    kind = f"kernel-stock-{arch.debian}-{suite}"
    place = cache.entry(kind, [arch.kernel_flavour, "layout 1"], lambda out: _fetch_of_suite(cache, arch, suite, out))
    build = Path((place / "build").read_text())
    release = build.name.removeprefix("linux-headers-")
    image = next((place / "root").rglob("vmlinuz*"))  # in /boot, or from 7 on beside the modules
    return Kernel(release, arch, image, build, place / "root", cross_prefix(arch), foreign=True)


def _fetch_of_suite(cache: Cache, arch: Arch, suite: str, place: Path) -> None:
    """The kernel that belongs to the headers which the modules are built against elsewhere, too."""
    headers = [REPOSITORY / "kmod/headers.sh", suite, arch.debian]
    build = run(headers, env={"CM_VM_CACHE": str(cache.root)}).splitlines()[-1]
    release = Path(build).name.removeprefix("linux-headers-")
    foreign = Apt(cache.root, arch, suite)
    parts = foreign.known([f"linux-{part}-{release}" for part in ("image", "binary", "modules")])  # before 7: one
    unpack(foreign.download(parts, place / "debs"), place / "root")
    shutil.rmtree(place / "debs")
    for module in (place / "root").rglob("*.ko.xz"):  # busybox loads them as they are
        run(["xz", "-d", module])
    run(["depmod", "-b", place / "root", release])
    (place / "build").write_text(build)
