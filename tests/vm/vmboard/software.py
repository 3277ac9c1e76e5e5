# SPDX-License-Identifier: Apache-2.0
"""Our own software for the board: the Python package with its compiled module, the kernel modules, the overlays."""

from __future__ import annotations

import importlib.util
import io
import os
import shutil
from contextlib import redirect_stdout
from pathlib import Path

from vmboard import rootfs
from vmboard.arch import ARMHF, Arch, cross_prefix
from vmboard.cache import Cache, source_files
from vmboard.kernel import Kernel
from vmboard.paths import REPOSITORY
from vmboard.shell import require, run

TREES = REPOSITORY / "tests/vm/trees"  # of boards that are the virtual board's alone


def python_package(cache: Cache, arch: Arch) -> Path:
    """A folder for PYTHONPATH with the package `cm`, cross-compiled."""
    inputs = [arch.debian, REPOSITORY / "cm", REPOSITORY / "csrc", REPOSITORY / "kmod/uapi", Path(__file__)]
    return cache.entry(f"python-{arch.debian}", inputs, lambda place: _build_package(cache, arch, place))


def _build_package(cache: Cache, arch: Arch, place: Path) -> None:
    for path in source_files(REPOSITORY / "cm"):
        target = place / path.relative_to(REPOSITORY)
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(path, target)
    _compile_extension(cache, arch, place / "cm/device/native/_cm.abi3.so")
    _compile_messages(place)
    rootfs.compile_python(cache, arch, place, "cm", place="/opt/cm/python")


def _compile_extension(cache: Cache, arch: Arch, target: Path) -> None:
    """The cffi module: its C from the project's own description, through the board's compiler."""
    compiler = f"{cross_prefix(arch)}gcc"
    require(compiler)
    include = next(rootfs.headers(cache, arch).glob("python3.*"))
    generated = target.with_name("_cm.c")
    spec = importlib.util.spec_from_file_location("cm_build_cffi", REPOSITORY / "csrc/build_cffi.py")
    if spec is None or spec.loader is None:
        raise FileNotFoundError(REPOSITORY / "csrc/build_cffi.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    with redirect_stdout(io.StringIO()):
        module.ffibuilder.emit_c_code(str(generated))
    sources = sorted((REPOSITORY / "csrc").glob("*.c"))
    folders = [include, include.parent, include.parent / arch.gnu, REPOSITORY / "csrc", REPOSITORY / "csrc/cffi"]
    includes = [f"-I{folder}" for folder in [*folders[:1], *folders[3:], REPOSITORY / "kmod/uapi"]]
    # Debian's pyconfig.h includes <triplet/python3.x/pyconfig.h>, which lies below usr/include
    includes += [f"-idirafter{include.parent}"]
    options = ["-D_TIME_BITS=64"] if arch.debian == ARMHF.debian else []
    options += [
        "-D_GNU_SOURCE",
        "-D_FILE_OFFSET_BITS=64",
        "-shared",
        "-fPIC",
        "-std=gnu11",
        "-O2",
        "-DPy_LIMITED_API=0x03060000",
        "-pthread",
    ]
    run([compiler, *options, *includes, generated, *sources, "-o", target])
    generated.unlink()


def _compile_messages(place: Path) -> None:
    """Debian's protoc writes what Debian's protobuf runtime reads."""
    require("protoc")
    for proto in sorted((place / "cm").rglob("*.proto")):
        run(["protoc", f"--proto_path={place}", f"--python_out={place}", proto.relative_to(place)], cwd=place)


def kernel_modules(cache: Cache, kernel: Kernel) -> Path:
    """A folder with the modules of kmod/ (or of `$CM_VM_KMOD`) built for this kernel."""
    source = Path(os.environ.get("CM_VM_KMOD") or REPOSITORY / "kmod").resolve()
    inputs = [kernel.release, str(kernel.build), source]
    return cache.entry(f"kmod-{kernel.release}", inputs, lambda place: _build_modules(kernel, source, place))


def _build_modules(kernel: Kernel, source: Path, place: Path) -> None:
    if kernel.foreign:  # that is what build.sh knows about
        run([source / "build.sh", kernel.build, kernel.arch.debian, place], log=place / "build.log")
        return
    for path in source_files(source):
        target = place / path.relative_to(source)
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(path, target)
    run([*kernel.make(), f"-j{os.cpu_count() or 1}", f"M={place}", "modules"], log=place / "build.log")


def programs(cache: Cache, arch: Arch) -> Path:
    """A folder with the C programs of kmod/tests, static."""
    sources = sorted((REPOSITORY / "kmod/tests").glob("smoke_*.c"))
    inputs = [arch.debian, *sources, REPOSITORY / "kmod/tests/smoke.h", REPOSITORY / "kmod/uapi"]
    return cache.entry(f"programs-{arch.debian}", inputs, lambda place: _build_programs(arch, sources, place))


def _build_programs(arch: Arch, sources: list[Path], place: Path) -> None:
    compiler = f"{cross_prefix(arch)}gcc"
    require(compiler)
    for source in sources:
        options = ["-static", "-O2", "-Wall", f"-I{REPOSITORY / 'kmod/uapi'}"]
        run([compiler, *options, source, "-o", place / source.stem])


def overlays(cache: Cache) -> Path:
    """A folder with every compiled tree and overlay of dts/, and the trees of virtual boards."""
    require("dtc", "cpp", "make")
    source = REPOSITORY / "dts"
    return cache.entry("dts", [source, TREES], lambda place: _build_overlays(source, place))


def _build_overlays(source: Path, place: Path) -> None:
    run(["make", "-s", "-C", source, f"O={place}", "dtbo"])
    for tree in TREES.glob("*.dts"):
        expand = ["cpp", "-nostdinc", "-undef", "-D__DTS__", "-x", "assembler-with-cpp", "-I", source / "boards"]
        (place / tree.name).write_text(run([*expand, tree]))
        run(["dtc", "-q", "-@", "-I", "dts", "-O", "dtb", "-o", place / f"{tree.stem}.dtb", place / tree.name])
