# SPDX-License-Identifier: Apache-2.0
"""The PEP 517 backend of the tree, through the functions that installers call."""

from __future__ import annotations

import hashlib
import io
import os
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path
from types import ModuleType

import pytest
from scripts import script

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The backend in the tree, without what setuptools itself would do there."""
    backend = script("release/backend.py")
    monkeypatch.setattr(backend.build_meta, "get_requires_for_build_wheel", lambda settings: [])
    monkeypatch.delenv("PROTOC", raising=False)
    return backend


def test_grpcio_tools_are_asked_for_where_there_is_no_protoc(
    asked: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    assert asked.get_requires_for_build_wheel() == ["grpcio-tools>=1.48"]


def test_nothing_is_asked_for_where_there_is_a_protoc(
    asked: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "protoc").write_text("#!/bin/sh\n")
    (tmp_path / "protoc").chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert asked.get_requires_for_build_wheel() == []


def test_repacked_archives_do_not_reveal_who_packed_them(tmp_path: Path) -> None:
    backend = script("release/backend.py")
    hashes = set()
    for owner, mode, order in ((0, 0o600, "ab"), (1000, 0o664, "ba")):
        archive = tmp_path / f"{owner}.tar.gz"
        with tarfile.open(archive, "w:gz") as tar:
            for name in order:
                member = tarfile.TarInfo(name)
                member.uid, member.mtime, member.mode, member.size = owner, owner, mode, 1
                tar.addfile(member, io.BytesIO(name.encode()))
        backend.repack(archive, backend.EPOCH)
        hashes.add(hashlib.sha256(archive.read_bytes()).hexdigest())
    assert len(hashes) == 1


def _copy_of_the_tree(place: Path) -> Path:
    names = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True).stdout
    place.mkdir()
    subprocess.run(["xargs", "-0", "cp", "-P", "--parents", "-t", place], input=names, cwd=ROOT, check=True)
    return place


def _build(tree: Path, kind: str, out: Path) -> Path:
    script = f"import sys; sys.path.insert(0, 'release'); import backend; print(backend.build_{kind}({str(out)!r}))"
    environment = {**os.environ, "SOURCE_DATE_EPOCH": "1700000000", "PYTHONWARNINGS": "ignore"}
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=tree, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return out / done.stdout.splitlines()[-1]


@pytest.mark.skipif(not (ROOT / ".git").exists(), reason="needs a git checkout: copies what is in version control")
@pytest.mark.timeout(600)
def test_a_wheel_from_the_sdist_is_that_of_the_tree(tmp_path: Path) -> None:
    tree = _copy_of_the_tree(tmp_path / "tree")
    wheel = _build(tree, "wheel", tmp_path)
    sdist = _build(tree, "sdist", tmp_path)
    with tarfile.open(sdist) as tar:
        tar.extractall(tmp_path / "a-longer-folder")
    (tmp_path / "again").mkdir()
    again = _build(next((tmp_path / "a-longer-folder").iterdir()), "wheel", tmp_path / "again")
    assert _contents(again) == _contents(wheel)
    assert again.read_bytes() == wheel.read_bytes()


def _contents(wheel: Path) -> dict[str, str]:
    with zipfile.ZipFile(wheel) as archive:
        return {name: hashlib.sha256(archive.read(name)).hexdigest() for name in archive.namelist()}
