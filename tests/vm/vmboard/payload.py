# SPDX-License-Identifier: Apache-2.0
"""The second disk: everything that changes with the repository, in one small ext4 image."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path

from vmboard import designs, software
from vmboard import silicon as models
from vmboard.cache import Cache
from vmboard.kernel import Kernel
from vmboard.paths import REPOSITORY
from vmboard.shell import run

HERE = REPOSITORY / "tests/vm"
# Drivers of the stock kernel that the board uses once its root file system is there.
STOCK_DRIVERS = ("configfs", "uio", "virtio_net", "virtio_console", "virtio_rng")
SHARED_TESTS = ("device", "data")


def image(cache: Cache, kernel: Kernel, driver: models.Source | None = None) -> Path:
    """The ext4 image with our software, tests and kernel modules for one kernel, and another's driver of engines."""
    package = software.python_package(cache, kernel.arch)
    modules = [software.kernel_modules(cache, kernel)]
    silicon = models.modules(cache, kernel, driver)
    modules += [silicon] if silicon else []
    trees = software.overlays(cache)
    programs = software.programs(cache, kernel.arch)
    made_designs = designs.folder(cache)
    tests = [REPOSITORY / "tests" / name for name in SHARED_TESTS if (REPOSITORY / "tests" / name).exists()]
    made = [package.name, *(folder.name for folder in modules), trees.name, programs.name, made_designs.name]
    inputs = [kernel.release, str(kernel.build), *made, HERE, *tests]

    def build(place: Path) -> None:
        root = place / "root"
        _copy_software(root, package, trees, tests)
        shutil.copytree(programs, root / "bin", ignore=shutil.ignore_patterns(".*"))
        shutil.copytree(made_designs, root / "designs", ignore=shutil.ignore_patterns(".*", "*.dtso"))
        copy_modules(root, kernel, STOCK_DRIVERS, modules)
        filesystem = ["-t", "ext4", "-O", "^has_journal", "-L", "cm-payload"]
        run(["mke2fs", "-q", *filesystem, "-d", root, place / "payload.ext4", "128M"])
        shutil.rmtree(root)

    return cache.entry(f"payload-{kernel.release}", inputs, build) / "payload.ext4"


def _copy_software(root: Path, package: Path, trees: Path, tests: list[Path]) -> None:
    shutil.copytree(package / "cm", root / "python/cm")
    shutil.copytree(HERE / "guest", root / "guest")
    shutil.copytree(HERE / "cases", root / "tests/vm/cases", ignore=shutil.ignore_patterns("__pycache__"))
    for folder in tests:
        shutil.copytree(folder, root / "tests" / folder.name, ignore=shutil.ignore_patterns("__pycache__"))
    (root / "firmware").mkdir()
    for tree in trees.rglob("*.dtbo"):
        target = root / "firmware" / tree.relative_to(trees)
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(tree, target)


def copy_modules(root: Path, kernel: Kernel, drivers: tuple[str, ...], ours: Sequence[Path] = ()) -> None:
    """lib/modules for modprobe: a custom kernel's own, or the named drivers of the stock one; and ours."""
    target = root / "lib/modules" / kernel.release
    source = kernel.modules / "lib/modules" / kernel.release
    target.mkdir(parents=True, exist_ok=True)
    for name in ("modules.order", "modules.builtin", "modules.builtin.modinfo"):
        if (source / name).exists():
            shutil.copy2(source / name, target / name)
    for path in _wanted(source, drivers):
        copy = target / path.relative_to(source)
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(path, copy)
    (target / "updates").mkdir()
    for path in sorted(path for folder in ours for path in folder.rglob("*.ko")):
        shutil.copy2(path, target / "updates" / path.name)
    run(["depmod", "-b", root, kernel.release])


def _wanted(source: Path, drivers: tuple[str, ...]) -> list[Path]:
    dependencies = read_dependencies(source)
    if len(dependencies) < 200:
        return [source / name for name in dependencies]
    return [source / name for name in closure(dependencies, drivers)]


def read_dependencies(source: Path) -> dict[str, list[str]]:
    """modules.dep: each module's path with the paths of what it needs, nearest first."""
    lines = (source / "modules.dep").read_text().splitlines()
    return {name: needs.split() for name, needs in (line.split(":", 1) for line in lines)}


def closure(dependencies: dict[str, list[str]], names: tuple[str, ...]) -> list[str]:
    """Paths of the named modules and all they need, in an order in which they can be loaded; built-in ones drop out."""
    by_name = {Path(path).name.split(".")[0].replace("-", "_"): path for path in dependencies}
    ordered: dict[str, None] = {}
    for name in names:
        path = by_name.get(name)
        if path is not None:
            ordered.update(dict.fromkeys([*reversed(dependencies[path]), path]))
    return list(ordered)
