# SPDX-License-Identifier: Apache-2.0
"""Our packages for a board of Debian: built, on a disk like a folder of artefacts, the kernel modules by DKMS."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

from vmboard import initrd, qemu, software
from vmboard import kernel as kernels
from vmboard.arch import Arch
from vmboard.booted import Booted
from vmboard.cache import Cache, source_files
from vmboard.debian import System, system
from vmboard.errors import MissingError, VmError
from vmboard.paths import REPOSITORY
from vmboard.progress import say
from vmboard.shell import run
from vmboard.tiers import Tier

RELEASE = REPOSITORY / "build/release"
BOARD = REPOSITORY / "tests/vm/guest/installed"  # what stands in for the PL, and starts before the service
SHARED = REPOSITORY / "tests/vm/guest/board.sh"
SOURCES = ("cm", "csrc", "kmod", "debian", "release", "system", "setup.py", "pyproject.toml", "MANIFEST.in")
WHEELS = {"arm64": "aarch64", "armhf": "armv7l"}
BRIDGES = REPOSITORY / "tests/vm/wheels.txt"
PLATFORMS = {  # whose wheels run on the board
    "arm64": ("manylinux2014_aarch64", "manylinux_2_28_aarch64"),
    "armhf": ("manylinux2014_armv7l", "manylinux_2_17_armv7l", "manylinux_2_31_armv7l"),
}
MODULES = "fpga-cm-dkms_*.deb"
COMPILING_S = 3600.0  # an emulated processor compiles for minutes
MOUNT = "mount -o ro /dev/disk/by-id/virtio-cm-payload /opt/cm"


def artefacts(arch: Arch) -> list[Path]:
    """Packages and wheel of this tree for an architecture; built where they are older than a source."""
    found = _found(arch)
    newest = max(path.stat().st_mtime for name in SOURCES for path in source_files(REPOSITORY / name))
    if len(found) < 6 or min(path.stat().st_mtime for path in found) < newest:
        say(f"building packages for {arch.debian}")
        run(["make", "-C", REPOSITORY, "deb", f"ARCHES={arch.debian}", f"PYTHON={sys.executable}"])
        found = _found(arch)
    if len(found) < 6:
        raise MissingError(
            f"packages for {arch.debian} could not be built here; `make deb ARCHES={arch.debian}` says why"
        )
    return found


def _found(arch: Arch) -> list[Path]:
    patterns = (f"fpga-cm_*_{arch.debian}.deb", "*fpga-cm-[dsbc]*_all.deb", f"*_{WHEELS[arch.debian]}.whl")
    return sorted(path for pattern in patterns for path in RELEASE.glob(pattern))


def wheels(cache: Cache, arch: Arch) -> Path:
    """A folder of what the bridges need and Debian has no package of, for its Python; fetched when the pins change."""
    inputs = [BRIDGES, arch.python, *PLATFORMS[arch.debian]]
    return cache.entry(f"wheels-{arch.label}", inputs, lambda out: _fetch(arch, out))


def _fetch(arch: Arch, out: Path) -> None:
    options = ["--require-hashes", "--no-deps", "--only-binary=:all:", "--python-version", arch.python]
    options += [word for platform in PLATFORMS[arch.debian] for word in ("--platform", platform)]
    try:
        run([sys.executable, "-m", "pip", "download", "--quiet", *options, "--dest", out, "-r", BRIDGES])
    except VmError as error:
        raise MissingError(f"the wheels in {BRIDGES.name} cannot be fetched: {str(error).splitlines()[-1]}") from None


def disk(files: list[Path], place: Path, bridges: Path | None = None, logic: Path | None = None) -> Path:
    """A disk with the artefacts, the configuration's archive, the upgrade, and what a board has instead of a PL.

    `bridges` is the folder of wheels for them, `logic` the module of the simulated PL, which our packages lack.
    """
    from vmboard.camera import archive

    root = place / "disk"
    shutil.rmtree(root, ignore_errors=True)
    (root / "release").mkdir(parents=True)
    for path in files:
        shutil.copy2(path, root / "release" / path.name)
    (root / "release/camera.tar.gz").write_bytes(archive())
    _newer(next(path for path in files if path.name.startswith("fpga-cm_")), root)
    if bridges is not None:
        shutil.copytree(bridges, root / "wheels")
    (root / "second.tar.gz").write_bytes(archive("second"))
    shutil.copy2(REPOSITORY / "system/sysv/cm", root / "sysv")
    shutil.copytree(BOARD, root / "board")
    shutil.copy2(SHARED, root / "board")
    if logic is not None:
        shutil.copy2(logic, root / "board")
    image = place / "disk.ext4"
    run(["mke2fs", "-q", "-t", "ext4", "-O", "^has_journal", "-d", root, image, "64M"])
    return image


def _newer(deb: Path, root: Path) -> None:
    """The same package under a later version number, for an upgrade."""
    unpacked = root.parent / "newer"
    shutil.rmtree(unpacked, ignore_errors=True)
    run(["dpkg-deb", "-R", deb, unpacked])
    control = unpacked / "DEBIAN/control"
    lines = control.read_text().splitlines(keepends=True)
    control.write_text("".join(f"{line[:-1]}+later\n" if line.startswith("Version: ") else line for line in lines))
    (root / "later").mkdir()
    run(["dpkg-deb", "--root-owner-group", "-b", unpacked, root / "later"])


def prepared(cache: Cache, tier: Tier) -> tuple[System, Path]:
    """The board's Debian with our kernel modules, and the wheels for its bridges."""
    fetched = wheels(cache, tier.arch)  # seconds, so it is known at once where they cannot be had
    return with_modules(cache, tier), fetched


def with_modules(cache: Cache, tier: Tier) -> System:
    """The board's Debian with our kernel modules, as DKMS built them there from our package."""
    plain = system(cache, tier.arch)
    package = [REPOSITORY / "debian" / name for name in ("rules", "control", "changelog", "fpga-cm-dkms.postinst")]
    inputs = [plain.folder.name, REPOSITORY / "kmod", *package, BOARD, SHARED]
    place = cache.entry(f"modules-{tier.arch.label}", inputs, lambda out: _install(cache, tier, plain, out))
    return System(plain.kernel, place / "root.ext4")


def release(arch: Arch, root: System) -> list[Path]:
    """The artefacts, with the modules' package that the system has: one with another changelog would be built again."""
    built = next(root.folder.glob(MODULES))
    return [built if path.match(MODULES) else path for path in artefacts(arch)]


def _install(cache: Cache, tier: Tier, plain: System, place: Path) -> None:
    copy(plain.root, place / "root.ext4")
    files = artefacts(tier.arch)
    logic = software.kernel_modules(cache, kernels.stock(cache, tier.arch)) / "cm_plsim.ko"
    image = disk(files, place, logic=logic)
    board = Booted(machine(cache, tier, System(plain.kernel, place / "root.ext4"), image), place / "log")
    board.boot()
    try:
        board.do(MOUNT)
        board.do("cd /opt/cm/release && apt-get install -y ./fpga-cm-dkms_*.deb", patience_s=COMPILING_S)
        status = board.do("dkms status")
        if "installed" not in status:
            raise VmError(f"DKMS did not build the modules: {status}")
        board.do("sh /opt/cm/board/setup")
        board.shut_down()
    finally:
        board.close()
    shutil.copy2(next(path for path in files if path.match(MODULES)), place)
    for made in (image, place / "disk", place / "newer"):
        shutil.rmtree(made) if made.is_dir() else made.unlink()


def copy(image: Path, target: Path) -> None:
    """A disk of one's own; holes stay holes."""
    run(["cp", "--reflink=auto", "--sparse=always", image, target])


def machine(
    cache: Cache, tier: Tier, root: System, payload: Path, forwards: dict[int, int] | None = None
) -> qemu.Machine:
    """The board with systemd as its first process."""
    return qemu.Machine(
        arch=tier.arch,
        image=root.kernel.image,
        root=root.root,
        payload=payload,
        memory_mb=tier.memory_mb,
        initrd=initrd.image(cache, root.kernel),
        slow=tier.slow,
        arguments=("systemd.show_status=0", "quiet"),
        forwards=forwards or {},
        init="/lib/systemd/systemd",
        cpus=4,
    )
