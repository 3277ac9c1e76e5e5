# SPDX-License-Identifier: Apache-2.0
"""Archives of `cm build collect` onto a board: whole or not at all, whatever is in them."""

from __future__ import annotations

import hashlib
import io
import json
import tarfile
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cm.build.collect.layout import archive
from cm.cli.main import main
from cm.errors import CmError
from cm.importers import unpack
from cm.schema import load_folder

EDGE, GREY = b"the edge circuit" * 100, b"the grey one" * 70
SCHEMA = f"""
config:
  name: vision
  modules:
    edge: {{bitstream: edge.bin, sha256: {hashlib.sha256(EDGE).hexdigest()}}}
    grey: {{bitstream: grey.bin, sha256: {hashlib.sha256(GREY).hexdigest()}}}
  modes:
    contours: {{modules: [edge]}}
    plain: {{modules: [grey]}}
""".encode()
GOOD = {"vision.yaml": SCHEMA, "edge.bin": EDGE, "grey.bin": GREY}
ABSOLUTE = SCHEMA.replace(b"bitstream: edge.bin", b"bitstream: /bin/sh")


def packed(folder: Path, files: Mapping[str, bytes], name: str = "vision") -> Path:
    """As the build tool packs it."""
    return written(folder, archive(name, files))


def written(folder: Path, data: bytes) -> Path:
    """An archive of any bytes."""
    path = folder / "vision.tar.gz"
    path.write_bytes(data)
    return path


def made(folder: Path, *members: tuple[tarfile.TarInfo, bytes]) -> Path:
    """An archive of any members."""
    path = folder / "vision.tar.gz"
    with tarfile.open(path, "w:gz") as tar:
        for info, data in members:
            info.size = len(data)
            tar.addfile(info, io.BytesIO(data))
    return path


def member(name: str, data: bytes = b"", kind: bytes = tarfile.REGTYPE) -> tuple[tarfile.TarInfo, bytes]:
    """A member of any name and kind; links lead to /etc/passwd."""
    info = tarfile.TarInfo(name)
    info.type, info.linkname = kind, "" if kind == tarfile.REGTYPE else "/etc/passwd"
    return info, data


def without(name: str) -> dict[str, bytes]:
    """The good files but one."""
    return {key: data for key, data in GOOD.items() if key != name}


def held(folder: Path) -> dict[str, bytes]:
    """Every file below a folder, hidden ones too."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def laid_out(files: Mapping[str, bytes]) -> dict[str, bytes]:
    """What is held where a configuration lies."""
    return {f"vision/{name}": data for name, data in files.items()}


def test_it_lies_in_the_folder_as_it_was_packed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, out = packed(tmp_path, GOOD), tmp_path / "firmware"
    assert main(["import", "archive", str(source), "--out", str(out)]) == 0
    assert "configuration vision, 2 modules, 2 modes, 3 files" in capsys.readouterr().out
    assert held(out) == laid_out(GOOD)
    assert list(load_folder(out / "vision")) == ["vision"]


def test_the_folder_may_be_named_from_where_one_stands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = packed(tmp_path, GOOD)
    monkeypatch.chdir(tmp_path)
    assert main(["import", "archive", str(source), "--out", "firmware"]) == 0
    assert held(tmp_path / "firmware") == laid_out(GOOD)


def test_scripts_can_read_what_was_done(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, out = packed(tmp_path, GOOD), tmp_path / "firmware"
    assert main(["import", "archive", str(source), "--out", str(out), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said == {"config": "vision", "folder": str(out / "vision"), "files": sorted(GOOD)}


def test_a_newer_one_takes_the_place_of_the_old_with_nothing_left_of_it(tmp_path: Path) -> None:
    out = tmp_path / "firmware"
    unpack(packed(tmp_path, {**GOOD, "notes.txt": b"old"}), out)
    unpack(packed(tmp_path, GOOD), out)
    assert held(out) == laid_out(GOOD)


def test_what_a_killed_import_moved_away_is_not_in_the_way_of_the_next(tmp_path: Path) -> None:
    out = tmp_path / "firmware"
    unpack(packed(tmp_path, GOOD), out)
    (out / "vision").rename(out / ".vision.old")
    unpack(packed(tmp_path, GOOD), out)
    assert held(out) == laid_out(GOOD)


HOSTILE: dict[str, tuple[Callable[[Path], Path], str]] = {
    "not a tar": (lambda f: written(f, b"no archive"), "no whole tar"),
    "not there": (lambda f: f / "gone.tar.gz", "gone.tar.gz"),
    "empty": (made, "no files"),
    "cut off": (lambda f: written(f, archive("vision", GOOD)[:-40]), "no whole tar"),
    "leaves the folder": (lambda f: made(f, member("vision/../../x")), "<configuration>/<file>"),
    "absolute": (lambda f: made(f, member("/etc/x")), "<configuration>/<file>"),
    "too deep": (lambda f: made(f, member("vision/a/b")), "<configuration>/<file>"),
    "no folder": (lambda f: made(f, member("vision.yaml", SCHEMA)), "<configuration>/<file>"),
    "dots": (lambda f: made(f, member("../vision.yaml", SCHEMA)), "<configuration>/<file>"),
    "hidden": (lambda f: made(f, member(".vision/vision.yaml", SCHEMA)), "one configuration"),
    "two of them": (lambda f: made(f, member("a/x"), member("b/x")), "one configuration"),
    "twice": (lambda f: made(f, member("vision/x", b"1"), member("vision/x", b"2")), "twice"),
    "symbolic link": (lambda f: made(f, member("vision/x", kind=tarfile.SYMTYPE)), "no plain file"),
    "hard link": (lambda f: made(f, member("vision/x", kind=tarfile.LNKTYPE)), "no plain file"),
    "device": (lambda f: made(f, member("vision/x", kind=tarfile.CHRTYPE)), "no plain file"),
    "another name": (lambda f: packed(f, GOOD, name="other"), "configuration 'other' is expected"),
    "no schema": (lambda f: packed(f, without("vision.yaml")), "there is none"),
    "a file is missing": (lambda f: packed(f, without("edge.bin")), "no file edge.bin"),
    "another file": (lambda f: packed(f, {**GOOD, "edge.bin": EDGE[:-1] + b"!"}), "edge.bin is not the file"),
    "a file of the board": (lambda f: packed(f, {**GOOD, "vision.yaml": ABSOLUTE}), "does not come with it"),
    "a wrong schema": (lambda f: packed(f, {**GOOD, "vision.yaml": b"config: 7"}), "config"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_what_is_wrong_is_refused_and_the_folder_is_as_before(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    make, words = HOSTILE[name]
    out = tmp_path / "firmware"
    unpack(packed(tmp_path, {**GOOD, "notes.txt": b"old"}), out)
    before = held(out)
    assert main(["import", "archive", str(make(tmp_path)), "--out", str(out)]) == 1
    assert words in capsys.readouterr().err
    assert held(out) == before
    assert {path.name for path in tmp_path.iterdir()} == {"firmware", "vision.tar.gz"}


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_damage_anywhere_is_refused_or_does_no_harm(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    folder = tmp_path_factory.mktemp("a")
    whole = bytearray(archive("vision", GOOD))
    for _ in range(data.draw(st.integers(1, 4))):
        whole[data.draw(st.integers(0, len(whole) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    out = folder / "firmware"
    try:
        unpack(written(folder, bytes(whole)), out)
    except CmError:
        assert held(out) == {}
    else:
        assert held(out) == laid_out(GOOD)
