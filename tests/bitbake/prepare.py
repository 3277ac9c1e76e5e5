#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""What BitBake would have built before our recipes, from Debian: headers of an arm64 kernel and of Python, tools.

tests/bitbake/prepare.py FOLDER OECORE    (OECORE is a clone of openembedded-core)
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "vm"))

from vmboard import camera, kernel, rootfs
from vmboard.arch import ARM64
from vmboard.cache import Cache, default_root
from vmboard.packages import Apt, unpack

ROOT = Path(__file__).resolve().parents[2]
INSTALLER = "meta/recipes-devtools/python/python3-installer/interpreter.patch"
SOURCES = "meta/recipes-devtools/dwarfsrcfiles/files/dwarfsrcfiles.c"
PYTHON = """#!/bin/sh
# Debian's Python as the native one: it is told the target's settings, and has OE's patched installer.
export _PYTHON_SYSCONFIGDATA_NAME=_sysconfigdata__aarch64-linux-gnu
export PYTHONPATH={tools}/modules:{root}:$PYTHONPATH PYTHONDONTWRITEBYTECODE=1
exec /usr/bin/python3 "$@"
"""
BUILD = """#!/bin/sh
exec nativepython3 -m build "$@"
"""
# Debian's Python installs below dist-packages, and is of another version than that of the series.
SITE = """import os, sysconfig
folder = os.environ.get("CM_PYTHON_DIR")
if folder:
    site = f"/usr/lib/{folder}/site-packages"
    sysconfig._INSTALL_SCHEMES["posix_local"].update(purelib=site, platlib=site, scripts="/usr/bin", data="/usr")
"""
# The class useradd gives them a root; Debian's own refuse to work in one without being root.
USERS = {
    "groupadd": """#!/bin/sh
while [ $# -gt 1 ]; do [ "$1" != --root ] || etc=$2/etc; shift; done
grep -q "^$1:" "$etc/group" || echo "$1:x:$((800 + $(wc -l <"$etc/group"))):" >>"$etc/group"
""",
    "useradd": """#!/bin/sh
all="$*"
while [ $# -gt 1 ]; do [ "$1" != --root ] || root=$2; shift; done
groupadd --root "$root" "$1"
number=$(grep "^$1:" "$root/etc/group" | cut -d : -f 3)
grep -q "^$1:" "$root/etc/passwd" || echo "$1:x:$number:$number:$all:/:/sbin/nologin" >>"$root/etc/passwd"
""",
}


def headers_of_the_kernel(cache: Cache, place: Path) -> None:
    """`source` and `build` in `place`, as the kernel's recipe leaves them; the programs in them are the host's."""
    stock = kernel.stock(cache, ARM64)
    usr = stock.build.parents[1]
    shutil.copytree(usr, place / "usr", symlinks=True, ignore=shutil.ignore_patterns("modules", "share"))
    sources = place / "usr/src"
    for makefile in sources.glob("linux-headers-*/Makefile"):
        makefile.write_text(makefile.read_text().replace(str(stock.build.parent), str(sources)))
    (place / "build").symlink_to(sources / stock.build.name)
    (place / "source").symlink_to(next(sources.glob("linux-headers-*-common")))
    (place / "build/kernel-abiversion").write_text(stock.release)


def headers_of_python(cache: Cache, tools: Path) -> None:
    """`include` below `tools`, and the settings with which the target's Python was built among its modules."""
    shutil.copytree(rootfs.headers(cache, ARM64), tools / "include", symlinks=True)
    fetched = Apt(cache.root, ARM64).download(["libpython3.11-minimal", "libpython3.11-stdlib"], tools / "debs")
    unpack(fetched, tools / "python")
    settings = next((tools / "python").rglob("_sysconfigdata_*.py"))
    shutil.copy2(settings, tools / "modules/_sysconfigdata__aarch64-linux-gnu.py")


def tools_of_the_host(tools: Path, core: Path) -> None:
    """Python, OE's way of installing wheels and its lister of sources."""
    shutil.copytree("/usr/lib/python3/dist-packages/installer", tools / "modules/installer")
    patch = ["patch", "-s", "-p2", "-d", str(tools / "modules"), "-i", str(core / INSTALLER)]
    subprocess.run(patch, check=True)
    (tools / "modules/sitecustomize.py").write_text(SITE)
    scripts = {"nativepython3": PYTHON.format(tools=tools, root=ROOT), "pyproject-build": BUILD, **USERS}
    for name, text in scripts.items():
        (tools / name).write_text(text)
        (tools / name).chmod(0o755)
    subprocess.run(["gcc", "-o", tools / "dwarfsrcfiles", core / SOURCES, "-ldw", "-lelf"], check=True)


def main() -> None:
    """Fill a folder."""
    place, core = Path(sys.argv[1]).resolve(), Path(sys.argv[2]).resolve()
    tools, cache = place / "tools", Cache(default_root())
    (tools / "modules").mkdir(parents=True)
    headers_of_the_kernel(cache, place / "kernel")
    headers_of_python(cache, tools)
    tools_of_the_host(tools, core)
    (place / "camera.tar.gz").write_bytes(camera.archive())


if __name__ == "__main__":
    main()
