# SPDX-License-Identifier: Apache-2.0
"""The archive for a board: what its `install` puts where, and takes away again."""

from __future__ import annotations

import shutil
import subprocess
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture
def bundle(tmp_path: Path) -> Path:
    """One of few files, as release/board_bundle.sh puts it together."""
    folder = tmp_path / "bundle"
    (folder / "files/etc/cm").mkdir(parents=True)
    (folder / "files/usr/local/bin").mkdir(parents=True)
    shutil.copy(ROOT / "release/board/install", folder)
    shutil.copy(ROOT / "release/board/cm", folder / "files/usr/local/bin")
    (folder / "files/etc/cm/cm.yaml").write_text("# as shipped\n")
    (folder / "kernel").write_text("5.15.19-xilinx-v2022.1\n")
    (folder / "cm_dma.ko").write_bytes(b"a module")
    with zipfile.ZipFile(folder / "fpga_cm-1-py3-none-any.whl", "w") as wheel:
        wheel.writestr("cm/__init__.py", "")
    return folder


def install(bundle: Path, root: Path, *more: str) -> None:
    subprocess.run([bundle / "install", "--root", root, *more], check=True, capture_output=True)


def files(root: Path) -> set[str]:
    return {str(path.relative_to(root)) for path in root.rglob("*") if path.is_file()}


def test_a_board_gets_modules_of_its_kernel_the_package_and_the_command(bundle: Path, tmp_path: Path) -> None:
    root = tmp_path / "root"
    install(bundle, root)
    assert files(root) == {
        "etc/cm/cm.yaml", "lib/modules/5.15.19-xilinx-v2022.1/updates/cm/cm_dma.ko", "opt/cm/lib/cm/__init__.py",
        "usr/local/bin/cm",
    }  # fmt: skip


def test_settings_that_were_changed_stay_when_it_is_installed_again_and_when_it_is_removed(
    bundle: Path, tmp_path: Path
) -> None:
    root = tmp_path / "root"
    install(bundle, root)
    (root / "etc/cm/cm.yaml").write_text("name: mine\n")
    install(bundle, root)
    assert (root / "etc/cm/cm.yaml").read_text() == "name: mine\n"
    install(bundle, root, "--remove")
    assert files(root) == {"etc/cm/cm.yaml"}


def test_modules_of_another_kernel_are_refused_before_anything_is_written(bundle: Path) -> None:
    (bundle / "kernel").write_text("0.0.0-none\n")
    done = subprocess.run([bundle / "install"], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "run it as root" in done.stderr or "the modules are for kernel 0.0.0-none" in done.stderr
