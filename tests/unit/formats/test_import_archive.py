# SPDX-License-Identifier: Apache-2.0
"""Archives of `cm build collect` imported onto a board: completely or not at all, whatever they contain."""

from __future__ import annotations

import bz2
import gzip
import hashlib
import io
import json
import lzma
import os
import resource
import shutil
import subprocess
import sys
import tarfile
import zlib
from collections.abc import Callable, Mapping
from functools import partial
from importlib import import_module
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cm.cli.main import main
from cm.design.collect.collected import archive
from cm.errors import CmError
from cm.formats.importers import back, unpack, versions
from cm.schema import load_folder
from cm.server.settings.config_search import find_configs

VERSIONS = import_module("cm.formats.importers.config_versions")
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
    """An archive as the build tool packs it."""
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
    """The files at the place of a configuration."""
    return {f"vision/{name}": data for name, data in files.items()}


def test_an_archive_is_unpacked_exactly_as_it_was_packed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, out = packed(tmp_path, GOOD), tmp_path / "firmware"
    assert main(["import", "archive", str(source), "--out", str(out)]) == 0
    assert "configuration vision, 2 modules, 2 modes, 3 files" in capsys.readouterr().out
    assert held(out) == laid_out(GOOD)
    assert list(load_folder(out / "vision")) == ["vision"]


def test_the_folder_may_be_given_as_a_relative_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = packed(tmp_path, GOOD)
    monkeypatch.chdir(tmp_path)
    assert main(["import", "archive", str(source), "--out", "firmware"]) == 0
    assert held(tmp_path / "firmware") == laid_out(GOOD)


def test_scripts_can_read_what_was_done(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, out = packed(tmp_path, GOOD), tmp_path / "firmware"
    assert main(["import", "archive", str(source), "--out", str(out), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said == {"config": "vision", "folder": str(out / "vision"), "files": sorted(GOOD)}


def test_a_newer_version_replaces_the_old_one_completely(tmp_path: Path) -> None:
    out = tmp_path / "firmware"
    unpack(packed(tmp_path, {**GOOD, "notes.txt": b"old"}), out, keep=0)
    unpack(packed(tmp_path, GOOD), out, keep=0)
    assert held(out) == laid_out(GOOD)


def note(out: Path) -> bytes:
    return (out / "vision/notes.txt").read_bytes()


def imported(tmp_path: Path, *notes: bytes, keep: int = 3) -> Path:
    """A folder into which archives with these notes were unpacked, one after the other."""
    for text in notes:
        unpack(packed(tmp_path, {**GOOD, "notes.txt": text}), tmp_path / "firmware", keep)
    return tmp_path / "firmware"


def test_the_last_versions_are_kept(tmp_path: Path) -> None:
    out = imported(tmp_path, b"1", b"2", b"3", b"4", b"5", keep=2)
    kept = [(version.folder / "notes.txt").read_bytes() for version in versions(out, "vision")]
    assert kept == [b"4", b"3"]
    assert note(out) == b"5"


@pytest.mark.programs
def test_a_full_disk_leaves_the_version_that_is_in_force(
    small_disk: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["import", "archive", str(packed(tmp_path, GOOD)), "--out", str(small_disk)]) == 0
    large = os.urandom(2 << 20)
    schema = SCHEMA.replace(hashlib.sha256(EDGE).hexdigest().encode(), hashlib.sha256(large).hexdigest().encode())
    newer = packed(tmp_path, {**GOOD, "vision.yaml": schema, "edge.bin": large})
    assert main(["import", "archive", str(newer), "--out", str(small_disk)]) == 1
    assert "No space left" in capsys.readouterr().err
    assert set(load_folder(small_disk / "vision")) == {"vision"}
    assert (small_disk / "vision/edge.bin").read_bytes() == EDGE
    assert find_configs([f"{small_disk}/*"]).left_out == ()


def test_a_rollback_goes_to_the_youngest_and_the_next_one_forward_again(tmp_path: Path) -> None:
    out = imported(tmp_path, b"1", b"2", b"3")
    assert main(["config", "rollback", "vision", "--out", str(out)]) == 0
    assert note(out) == b"2"
    assert main(["config", "rollback", "vision", "--out", str(out)]) == 0
    assert note(out) == b"3"


def test_a_rollback_goes_to_the_version_that_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = imported(tmp_path, b"1", b"2", b"3")
    assert main(["config", "rollback", "vision", "--to", "0", "--out", str(out)]) == 1
    oldest = capsys.readouterr().err.rpartition("(there: ")[2].partition(")")[0].split(", ")[-1]
    assert main(["config", "rollback", "vision", "--to", oldest, "--out", str(out)]) == 0
    assert note(out) == b"1"


def test_a_rollback_without_an_earlier_version_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = imported(tmp_path, b"1")
    assert main(["config", "rollback", "vision", "--out", str(out)]) == 1
    assert "no earlier version" in capsys.readouterr().err


def test_version_0_is_one_that_is_not_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = imported(tmp_path, b"1", b"2")
    assert main(["config", "rollback", "vision", "--to", "0", "--out", str(out)]) == 1
    assert "no earlier version 0 of configuration vision" in capsys.readouterr().err


@pytest.mark.parametrize("words", [["import", "archive", "{}"], ["config", "rollback", "vision"]], ids=" ".join)
def test_a_file_is_no_folder_of_configurations(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str]
) -> None:
    file = packed(tmp_path, GOOD)
    assert main([*(word.format(file) for word in words), "--out", str(file)]) == 1
    assert f"{file} is a file, not a folder" in capsys.readouterr().err


def test_a_version_that_was_damaged_does_not_come_back(tmp_path: Path) -> None:
    out = imported(tmp_path, b"1", b"2")
    (versions(out, "vision")[0].folder / "edge.bin").write_bytes(b"rotten")
    with pytest.raises(CmError, match="not the file that the schema was made for"):
        back(out / "vision")
    assert note(out) == b"2"


def test_the_service_does_not_see_earlier_versions(tmp_path: Path) -> None:
    out = imported(tmp_path, b"1", b"2")
    found = find_configs([f"{out}/*"])
    assert [config.source for config in found.configs.values()] == [out / "vision/vision.yaml"]
    assert not found.left_out


def killed_at(step: int, work: Callable[[], object]) -> bool:
    """Do `work` in a process that dies before its n-th call that changes names; return whether it did die."""
    pid = os.fork()
    if pid == 0:
        left = [step]

        def counted(call: Callable[..., object]) -> Callable[..., object]:
            def wrapper(*arguments: object, **options: object) -> object:
                left[0] -= 1
                if left[0] < 0:
                    os._exit(9)
                return call(*arguments, **options)

            return wrapper

        for owner, name in ((VERSIONS, "exchange"), (os, "fsync"), (Path, "rename"), (shutil, "rmtree")):
            setattr(owner, name, counted(getattr(owner, name)))
        work()
        os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 9


@pytest.mark.parametrize("rolls_back", [False, True], ids=["import", "rollback"])
def test_killed_at_any_step_the_old_one_or_the_new_one_is_in_force(tmp_path: Path, rolls_back: bool) -> None:
    archive_of_new = packed(tmp_path, {**GOOD, "notes.txt": b"new"}).rename(tmp_path / "new.tar.gz")
    seen = set()
    for step in range(100):
        (tmp_path / str(step)).mkdir()
        out = imported(tmp_path / str(step), b"older", b"old")
        place = out / "vision"
        died = killed_at(step, partial(back, place) if rolls_back else partial(unpack, archive_of_new, out))
        now = note(out)
        assert held_files(place) == {**GOOD, "notes.txt": now}
        seen.add(now)
        imported(tmp_path / str(step), b"newest")
        assert note(out) == b"newest"
        assert {(kept.folder / "notes.txt").read_bytes() for kept in versions(out, "vision")} >= {b"older", b"old", now}
        if not died:
            break
    else:
        raise AssertionError("it never came to its end")
    assert seen == {b"old", b"older" if rolls_back else b"new"}


def held_files(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_a_rauc_handler_imports_all_or_none(tmp_path: Path) -> None:
    handler = Path(__file__).resolve().parents[3] / "system/rauc/cm-configs.sh"
    out = imported(tmp_path, b"old")
    bundle = tmp_path / "bundle"
    bundle.mkdir()
    packed(tmp_path, {**GOOD, "notes.txt": b"new"}).rename(bundle / "a.tar.gz")
    (bundle / "b.tar.gz").write_bytes(b"cut off")
    program = tmp_path / "cm"
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m cm.cli.main "$@"\n')
    program.chmod(0o755)
    environment = {
        **os.environ, "RAUC_BUNDLE_MOUNT_POINT": str(bundle), "CM_CONFIGS": str(out), "CM_RELOAD": "true",
        "CM": str(program), "PYTHONPATH": str(handler.parents[2]),
    }  # fmt: skip
    refused = subprocess.run([handler], env=environment, capture_output=True, text=True, check=False)
    assert refused.returncode == 1, refused.stderr
    assert note(out) == b"old"
    (bundle / "b.tar.gz").unlink()
    subprocess.run([handler], env=environment, check=True, capture_output=True)
    assert note(out) == b"new"


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
    "symbolic link": (lambda f: made(f, member("vision/x", kind=tarfile.SYMTYPE)), "not a plain file"),
    "hard link": (lambda f: made(f, member("vision/x", kind=tarfile.LNKTYPE)), "not a plain file"),
    "device": (lambda f: made(f, member("vision/x", kind=tarfile.CHRTYPE)), "not a plain file"),
    "another name": (lambda f: packed(f, GOOD, name="other"), "configuration 'other' is expected"),
    "no schema": (lambda f: packed(f, without("vision.yaml")), "there is none"),
    "a file is missing": (lambda f: packed(f, without("edge.bin")), "no file edge.bin"),
    "another file": (lambda f: packed(f, {**GOOD, "edge.bin": EDGE[:-1] + b"!"}), "edge.bin is not the file"),
    "a file of the board": (lambda f: packed(f, {**GOOD, "vision.yaml": ABSOLUTE}), "does not come with it"),
    "a wrong schema": (lambda f: packed(f, {**GOOD, "vision.yaml": b"config: 7"}), "config"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_bad_archive_is_refused_and_the_folder_is_unchanged(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    make, words = HOSTILE[name]
    out = tmp_path / "firmware"
    unpack(packed(tmp_path, {**GOOD, "notes.txt": b"old"}), out)
    before = held(out)
    assert main(["import", "archive", str(make(tmp_path)), "--out", str(out)]) == 1
    told = capsys.readouterr().err
    assert words in told
    assert ".import-" not in told, "a folder that is gone by now"
    assert held(out) == before
    assert {path.name for path in tmp_path.iterdir()} == {"firmware", "vision.tar.gz"}


def header(name: str, size: int, kind: bytes) -> bytes:
    info = tarfile.TarInfo(name)
    info.size, info.type = size, kind
    return info.tobuf(tarfile.GNU_FORMAT)


def long_names() -> bytes:
    """Headers of long names of 1 MiB each, one inside the other: tarfile keeps them all."""
    name = (b"vision/" + b"x" * (1 << 20))[: 1 << 20]
    return gzip.compress((header("././@LongLink", 1 << 20, b"L") + name) * 300, 1)


def pax_records() -> bytes:
    """A header of pax records whose lengths do not fit: tarfile searches it again for each."""
    body = b"1" * 500
    return header("vision/x", len(body), b"x") + body.ljust(512, b"\0")


def zeros(member: str, count: int = 3 << 30) -> bytes:
    """A file of zeros that has a thousandth of its size in the archive."""
    packer, block = zlib.compressobj(9, zlib.DEFLATED, 31), bytes(1 << 20)
    parts = [packer.compress(header(member, count, b"0"))]
    parts += [packer.compress(block) for _ in range(count >> 20 if count < 1 << 28 else 64)]
    return b"".join([*parts, packer.flush()])


def pax(key: bytes, value: bytes) -> bytes:
    length = len(key) + len(value) + 3
    while len(str(length)) + len(key) + len(value) + 3 != length:
        length += 1
    record = b"%d %s=%s\n" % (length, key, value)
    body = record.ljust(-(-len(record) // 512) * 512, b"\0")
    return header("x", len(record), b"x") + body + header("vision/x", 0, b"0") + bytes(1024)


def wrong_number() -> bytes:
    data = bytearray(header("vision/x", 0, b"0"))
    data[124:136] = b"-0000000001\0"
    data[148:156] = b"%06o\0 " % (sum(data[:148]) + 256 + sum(data[156:]))
    return bytes(data)


BOMBS: dict[str, tuple[Callable[[], bytes], str]] = {
    "long names": (long_names, "a long name or extended header of 1048576 bytes"),
    "long link": (lambda: header("x", 1 << 33, b"K"), "a long name or extended header of 8589934592 bytes"),
    "pax records": (pax_records, "a pax record of another length than it says"),
    "many pax headers": (lambda: gzip.compress(header("vision/x", 0, b"x") * 20000), "more than 4096 members"),
    "many members": (lambda: gzip.compress(b"".join(header(f"vision/{n}", 0, b"0") for n in range(5000))), "members"),
    "a size beyond": (lambda: zeros("vision/x"), "more than 1024 MiB unpacked"),
    "zeros behind": (lambda: gzip.compress(header("vision/x", 0, b"0") + bytes(40 << 20)), "behind the last file"),
    "bzip2": (lambda: bz2.compress(header("vision/x", 0, b"0") + bytes(40 << 20)), "behind the last file"),
    "xz": (lambda: lzma.compress(header("vision/x", 0, b"0") + bytes(40 << 20)), "behind the last file"),
    "zstd": (lambda: bytes.fromhex("28b52ffd") + bytes(1024), "a header's checksum is wrong"),
    "sparse": (lambda: header("vision/x", 0, b"S"), "not a plain file"),
    "sparse by pax": (lambda: pax(b"GNU.sparse.realsize", b"99999999999"), "a sparse file"),
    "hard link": (lambda: header("vision/x", 0, b"1"), "not a plain file"),
    "device": (lambda: header("vision/x", 0, b"4"), "not a plain file"),
    "a long name that leads out": (lambda: pax(b"path", b"../" * 100 + b"x"), "<configuration>/<file>"),
    "a name of 2 KiB": (lambda: pax(b"path", b"vision/" + b"x" * 2048), "a name of more than 512 bytes"),
    "no number": (wrong_number, "no octal number"),
}


def bounded() -> None:
    """512 MiB of memory and 20 s of processor time."""
    resource.setrlimit(resource.RLIMIT_AS, (512 << 20, 512 << 20))
    resource.setrlimit(resource.RLIMIT_CPU, (20, 20))


@pytest.mark.parametrize("name", BOMBS)
def test_a_bomb_is_refused_within_bounds_of_memory_and_time(name: str, tmp_path: Path) -> None:
    make, words = BOMBS[name]
    source, out = written(tmp_path, make()), tmp_path / "firmware"
    command = [sys.executable, "-m", "cm", "import", "archive", str(source), "--out", str(out)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, preexec_fn=bounded)
    assert (done.returncode, done.stdout) == (1, "")
    assert words in done.stderr
    assert "Traceback" not in done.stderr
    assert held(out) == {}


def test_where_a_signature_is_required_nothing_in_an_unsigned_archive_is_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "cm.yaml").write_text(f"policy: {{signatures: require, signers: {tmp_path}}}\n")
    source = packed(tmp_path, {**GOOD, "vision.yaml": b"config: [" * 1000})
    arguments = ["--out", str(tmp_path / "firmware"), "--settings", str(tmp_path / "cm.yaml")]
    assert main(["import", "archive", str(source), *arguments]) == 1
    assert "not signed" in capsys.readouterr().err


@pytest.mark.parametrize("form", [tarfile.USTAR_FORMAT, tarfile.GNU_FORMAT, tarfile.PAX_FORMAT])
@pytest.mark.parametrize("kind", ["", "gz", "bz2", "xz"])
def test_archives_of_other_tools_are_read_too(form: int, kind: str, tmp_path: Path) -> None:
    long = "a-name-as-long-as-file-systems-allow-" + "x" * 200 if form != tarfile.USTAR_FORMAT else "x" * 90
    path = tmp_path / "vision.tar"
    with tarfile.open(path, f"w:{kind}", format=form) as tar:
        for name, data in {**GOOD, long: b"1" * 70000}.items():
            info = tarfile.TarInfo(f"vision/{name}")
            info.size, info.mtime = len(data), 1.5 if form == tarfile.PAX_FORMAT else 1
            tar.addfile(info, io.BytesIO(data))
    unpack(path, tmp_path / "firmware")
    assert held(tmp_path / "firmware") == laid_out({**GOOD, long: b"1" * 70000})


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
