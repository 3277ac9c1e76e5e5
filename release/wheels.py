# SPDX-License-Identifier: Apache-2.0
"""Wheels for boards and desktops, each with the distribution's Python and cross compiler, and one for any system.

    release/wheels.py --out DIR [--arch amd64] [--arch arm64] [--arch armhf] [--pure] SDIST

They are built from the source archive, stripped, free of run paths, and tagged by the oldest glibc that has
every symbol that they use (PEP 600). Needs Debian's python3-{setuptools,cffi,yaml,fastjsonschema,wheel},
protobuf-compiler and the cross compilers; headers of other architectures come through apt (tests/vm/vmboard).
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PYTHON = "/usr/bin/python3"
_NEEDED = ("setuptools", "cffi", "yaml", "fastjsonschema", "wheel")  # modules, as Debian's packages call them too
_BUILD = "import sys, backend; backend.build_wheel(sys.argv[1])"
_OLDEST = 17  # of the manylinux tags
_GLIBC = re.compile(r"\bGLIBC_2\.(\d+)")

sys.path[:0] = [str(ROOT / "release"), str(ROOT / "tests/vm")]


@dataclass(frozen=True, slots=True)
class Target:
    """One architecture: as Debian, the compiler and wheels call it."""

    debian: str
    gnu: str
    machine: str

    @property
    def tool(self) -> str:
        """The prefix of its compiler."""
        return f"{self.gnu}-"


TARGETS = {
    target.debian: target
    for target in (
        Target("amd64", "x86_64-linux-gnu", "x86_64"),
        Target("arm64", "aarch64-linux-gnu", "aarch64"),
        Target("armhf", "arm-linux-gnueabihf", "armv7l"),
    )
}


def headers(target: Target) -> Path:
    """usr/include of an architecture's Python; fetched once."""
    from vmboard import rootfs
    from vmboard.arch import Arch
    from vmboard.cache import Cache, default_root
    from vmboard.errors import VmError

    cache, arch = Cache(default_root()), Arch(target.debian, "", target.gnu, target.machine, "", "")
    try:
        return rootfs.headers(cache, arch)
    except VmError:
        # One index of a mirror that is just being synced fails the whole update; the others have been fetched.
        (cache.root / f"apt-{target.debian}/fetched").touch()
        return rootfs.headers(cache, arch)


def absent(python: str) -> list[str]:
    """Debian's packages that building a wheel needs and this Python does not have."""
    script = "import importlib.util as u, sys; print(*(name for name in sys.argv[1:] if u.find_spec(name) is None))"
    said = subprocess.run([python, "-I", "-c", script, *_NEEDED], capture_output=True, text=True, check=True).stdout
    return [f"python3-{name}" for name in said.split()]


def build(sdist: Path, target: Target, out: Path) -> Path:
    """Build one wheel into `out`; its path."""
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        with tarfile.open(sdist) as tar:
            tar.extractall(work)
        source = next(path for path in work.iterdir() if path.is_dir())
        _run([PYTHON, "-c", _BUILD, str(work)], source, _environment(target, source))
        return _finish(next(work.glob("*.whl")), target, work, out)


def pure(sdist: Path, out: Path) -> Path:
    """Build the wheel without the compiled module, for clients on other systems, into `out`; its path."""
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        with tarfile.open(sdist) as tar:
            tar.extractall(work)
        source = next(path for path in work.iterdir() if path.is_dir())
        keep = {name: os.environ[name] for name in ("PATH", "HOME", "SOURCE_DATE_EPOCH") if name in os.environ}
        more = {"CM_PURE": "1", "PYTHONPATH": str(source / "release"), "SETUPTOOLS_USE_DISTUTILS": "local"}
        _run([PYTHON, "-c", _BUILD, str(work)], source, {**keep, **more, "LC_ALL": "C.UTF-8"})
        wheel = next(work.glob("*.whl"))
        out.mkdir(parents=True, exist_ok=True)
        (out / wheel.name).write_bytes(wheel.read_bytes())
        return out / wheel.name


def _environment(target: Target, source: Path) -> dict[str, str]:
    include = headers(target)
    python = next(include.glob("python3.*"))
    keep = {name: os.environ[name] for name in ("PATH", "HOME", "SOURCE_DATE_EPOCH") if name in os.environ}
    compiler = f"{target.tool}gcc"
    return {
        **keep,
        "LC_ALL": "C.UTF-8",
        "PYTHONPATH": str(source / "release"),
        "PYTHONDONTWRITEBYTECODE": "1",
        "SETUPTOOLS_USE_DISTUTILS": "local",
        "_PYTHON_HOST_PLATFORM": f"linux-{target.machine}",
        "CC": f"{compiler} -I{python} -idirafter {include}",
        "LDSHARED": str(_linker(source.parent / "link", compiler)),
        "CFLAGS": "-O2 -g0",
    }


def _linker(place: Path, compiler: str) -> Path:
    """A linker that does not take the building machine's own library folder, which distutils names."""
    drop = 'for word; do shift; case $word in -L/usr/lib/*) ;; *) set -- "$@" "$word" ;; esac; done'
    place.write_text(f'#!/bin/sh\n{drop}\nexec {compiler} -shared -Wl,-z,relro,-z,now "$@"\n')
    place.chmod(0o755)
    return place


def _finish(wheel: Path, target: Target, work: Path, out: Path) -> Path:
    """Strip the module, say the platform that it needs, and pack again."""
    import backend

    _run([PYTHON, "-m", "wheel", "unpack", "--dest", str(work / "unpacked"), str(wheel)], work)
    folder = next((work / "unpacked").iterdir())
    module = next(folder.rglob("_cm*.so"))
    _run([f"{target.tool}strip", "--strip-unneeded", str(module)], work)
    info = next(folder.glob("*.dist-info")) / "WHEEL"
    tag = f"manylinux_2_{_newest(module, target)}_{target.machine}"
    info.write_text(re.sub(r"(?m)^(Tag: \w+-\w+)-\w+$", rf"\1-{tag}", info.read_text()))
    (work / "packed").mkdir()
    _run([PYTHON, "-m", "wheel", "pack", "--dest-dir", str(work / "packed"), str(folder)], work)
    packed = next((work / "packed").iterdir())
    backend.plain_modes(packed)
    out.mkdir(parents=True, exist_ok=True)
    place = out / packed.name
    place.write_bytes(packed.read_bytes())
    return place


def _newest(module: Path, target: Target) -> int:
    """The minor number of the newest glibc version whose symbols a module uses."""
    listing = _run([f"{target.tool}objdump", "-T", str(module)], module.parent)
    return max([_OLDEST, *map(int, _GLIBC.findall(listing))])


def _run(command: Sequence[str], cwd: Path, environment: dict[str, str] | None = None) -> str:
    done = subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        end = "\n".join([*done.stdout.splitlines(), *done.stderr.splitlines()][-30:])
        raise SystemExit(f"{' '.join(command)} failed:\n{end}")
    return done.stdout


def main() -> int:
    """Build what is asked for; print the paths."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("sdist", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--arch", action="append", choices=list(TARGETS))
    parser.add_argument("--pure", action="store_true", help="also the one without the compiled module")
    chosen = parser.parse_args()
    if missing := absent(PYTHON):
        sys.exit(f"wheels are built by {PYTHON}, which lacks what they need: apt install {' '.join(missing)}")
    for name in chosen.arch or list(TARGETS):
        print(build(chosen.sdist.resolve(), TARGETS[name], chosen.out.resolve()))
    if chosen.pure:
        print(pure(chosen.sdist.resolve(), chosen.out.resolve()))
    return 0


if __name__ == "__main__":
    sys.exit(main())
