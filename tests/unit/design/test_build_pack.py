# SPDX-License-Identifier: Apache-2.0
"""The flow on another host: packed, run under another root with the stand-in for Vivado, and unpacked again."""

from __future__ import annotations

import io
import os
import shlex
import shutil
import subprocess
import tarfile
from pathlib import Path

import pytest
from build_support import copy_examples, generated, needs
from test_build_shells import SHELLS, made
from test_build_tcl import TCL, known_commands

from cm.cli.main import main
from cm.design.errors import BuildError
from cm.design.run.archive import unpack
from cm.design.run.flow import Flow, State
from cm.design.run.make import run_flow
from cm.design.run.vivado import Vivado

VIVADO = Path(__file__).parents[1] / "vivado_replay.sh"
pytestmark = [needs("make"), needs("tclsh"), needs("tar")]


@pytest.fixture(autouse=True)
def stand_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "known").write_text(known_commands())
    monkeypatch.setenv("CM_REPLAY", str(TCL))
    monkeypatch.setenv("CM_KNOWN", str(tmp_path / "known"))
    monkeypatch.setenv("CM_SEEN", str(tmp_path / "seen"))


def two_regions(tmp_path: Path) -> Path:
    """The example that reads another example's HDL; its build schema."""
    (tmp_path / "here").mkdir()
    generated(copy_examples(tmp_path / "here"), "two_regions")
    return tmp_path / "here/two_regions/build.yaml"


def packed(schema: Path, archive: Path, *more: str) -> Path:
    assert main(["build", "pack", "-f", str(archive), *more, str(schema)]) == 0
    return archive


def there(archive: Path, folder: Path) -> Path:
    """The archive extracted elsewhere; its output folder."""
    folder.mkdir(parents=True)
    subprocess.run(["tar", "-xf", archive, "-C", folder], check=True)
    (found,) = folder.rglob("pack.json")
    return found.parent


def make(out: Path, *targets: str) -> None:
    command = ["make", f"VIVADO={shlex.quote(str(VIVADO))}", *targets]
    done = subprocess.run(command, cwd=out, capture_output=True, text=True, check=False)
    logs = "".join(path.read_text() for path in (out / "logs").glob("*.log"))
    assert done.returncode == 0, done.stdout + done.stderr + logs


def states(out: Path) -> set[State]:
    return {entry.state for entry in Flow(out).plan()}


def test_a_flow_runs_under_another_root_and_comes_back_done(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    schema = two_regions(tmp_path)
    elsewhere = there(packed(schema, tmp_path / "flow.tar.gz"), tmp_path / "far away/host")
    shutil.move(tmp_path / "here", tmp_path / "unreachable")  # nothing there may read files from here
    make(elsewhere)
    make(elsewhere, "back")
    shutil.move(tmp_path / "unreachable", tmp_path / "here")
    seen = (tmp_path / "seen").read_text().splitlines()
    assert all(line.startswith(f"{elsewhere} ") for line in seen)
    capsys.readouterr()
    assert main(["build", "unpack", str(elsewhere / "back.tar.gz"), str(schema)]) == 0
    assert f"{len(Flow(schema.parent / 'build').steps)} steps" in capsys.readouterr().out
    assert states(schema.parent / "build") == {State.DONE}
    assert run_flow(schema.parent / "build", Vivado(VIVADO, (2023, 2)), 1, lambda _: None)


def test_the_same_flow_packs_to_the_same_bytes_none_of_which_name_a_folder_of_this_host(tmp_path: Path) -> None:
    schema = two_regions(tmp_path)
    for path in (tmp_path / "here").rglob("*"):
        os.utime(path, (1_700_000_000, 1_700_000_000))
    one, other = (packed(schema, tmp_path / f"{name}.tar.gz") for name in ("one", "other"))
    assert one.read_bytes() == other.read_bytes()
    with tarfile.open(one) as tar:
        for member in tar:
            assert not member.name.startswith("/")
            data = tar.extractfile(member)
            assert data
            assert str(tmp_path).encode() not in data.read(), member.name


def test_what_comes_back_is_taken_whole_or_not_at_all_and_not_run_again(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    """In a folder that was copied back, for a change."""
    schema = two_regions(tmp_path)
    out = schema.parent / "build"
    elsewhere = there(packed(schema, tmp_path / "flow.tar.gz"), tmp_path / "there")
    make(elsewhere)
    source, lost = tmp_path / "here/camera/hdl/camera_edge.v", elsewhere / "checkpoints/static_routed.dcp"
    text = source.read_text()
    source.write_text(text + "// changed\n")
    assert main(["build", "unpack", str(tmp_path / "there"), str(schema)]) == 1
    assert "camera/hdl/camera_edge.v: not what was packed any more" in capsys.readouterr().err
    source.write_text(text)
    lost.rename(tmp_path / "aside")
    with pytest.raises(BuildError, match=r"run_1 is done, but checkpoints/static_routed\.dcp did not come back"):
        unpack(tmp_path / "there", out)
    (tmp_path / "aside").rename(lost)
    assert not (out / "bitstreams").exists()
    assert unpack(tmp_path / "there", out).left == ()
    assert states(out) == {State.DONE}
    again = there(packed(schema, tmp_path / "again.tar.gz"), tmp_path / "once more")
    (tmp_path / "seen").unlink()
    make(again)
    assert not (tmp_path / "seen").exists()


def test_nothing_is_taken_back_when_a_file_was_changed_there(tmp_path: Path) -> None:
    schema = two_regions(tmp_path)
    elsewhere = there(packed(schema, tmp_path / "flow.tar.gz"), tmp_path / "there")
    script = elsewhere / "tcl/settings.tcl"
    script.write_text(script.read_text() + "# mended\n")
    make(elsewhere)
    with pytest.raises(BuildError, match="was run there with other files than were packed"):
        unpack(tmp_path / "there", schema.parent / "build")
    assert not (schema.parent / "build/bitstreams").exists()


def test_steps_that_did_not_run_are_reported_and_the_others_are_kept(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    schema = two_regions(tmp_path)
    elsewhere = there(packed(schema, tmp_path / "flow.tar.gz"), tmp_path / "there")
    make(elsewhere, "stamps/static.done")
    assert main(["build", "unpack", str(tmp_path / "there"), str(schema)]) == 1
    assert "step run_1 was not run to its end there" in capsys.readouterr().out
    done = {entry.step.name for entry in Flow(schema.parent / "build").plan() if entry.state is State.DONE}
    assert done == {"system", "static"}


def test_a_module_goes_alone_with_its_shell_and_nothing_of_the_static_design(tmp_path: Path) -> None:
    schema = made(tmp_path / "p")[0].project.source
    out = schema.parent / "build"
    whole = there(packed(schema, tmp_path / "whole.tar.gz"), tmp_path / "host")
    make(whole)
    unpack(tmp_path / "host", out)
    text = SHELLS + "  five: {sources: [one.v], top: one, regions: [left]}\n"
    made(tmp_path / "p", text)
    elsewhere = there(packed(schema, tmp_path / "five.tar.gz", "--module", "five"), tmp_path / "stranger")
    names = {path.name for path in (tmp_path / "stranger").rglob("*") if path.is_file()}
    assert not names & {
        "cm_static.v",
        "cm_top.v",
        "static_synth.dcp",
        "static_routed.dcp",
        "run_1.dcp",
        "block_design.tcl",
    }
    assert {"shell_left.dcp", "shell_left.id", "one.v"} <= names
    (tmp_path / "seen").unlink()
    make(elsewhere)
    make(elsewhere, "back")
    ran = [line.rpartition("step_")[2] for line in (tmp_path / "seen").read_text().splitlines()]
    assert ran == ["synth_five.tcl", "module_five.tcl"]
    assert unpack(elsewhere / "back.tar.gz", out).done == ("synth_five", "module_five")
    assert states(out) == {State.DONE}


def test_a_shell_that_was_made_anew_meanwhile_refuses_what_comes_back(tmp_path: Path) -> None:
    schema = made(tmp_path / "p")[0].project.source
    out = schema.parent / "build"
    make(out)
    elsewhere = there(packed(schema, tmp_path / "two.tar.gz", "--module", "two"), tmp_path / "stranger")
    make(elsewhere)
    (out / "checkpoints/shell_left.dcp").write_text("another\n")
    with pytest.raises(BuildError, match=r"checkpoints/shell_left\.dcp: not what was packed"):
        unpack(tmp_path / "stranger", out)


@pytest.mark.parametrize(
    ("name", "said"),
    [("two", "the abstract shell that module_two needs is not made yet"), ("one", "opens the whole static design")],
)
def test_a_module_that_cannot_go_alone_is_refused(
    name: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    schema = made(tmp_path / "p")[0].project.source
    assert main(["build", "pack", "--module", name, "-f", str(tmp_path / "x.tar.gz"), str(schema)]) == 1
    assert said in capsys.readouterr().err
    assert not (tmp_path / "x.tar.gz").exists()


def archive_of(folder: Path, **files: str) -> Path:
    path = folder / "back.tar.gz"
    with tarfile.open(path, "w:gz") as tar:
        for name, text in files.items():
            info = tarfile.TarInfo(name)
            info.size = len(text)
            tar.addfile(info, io.BytesIO(text.encode()))
    return path


@pytest.mark.parametrize(
    ("files", "said"),
    [
        ({"stamps/static.done": ""}, "holds no pack.json"),
        ({"../pack.json": "{}"}, "leads out of the archive"),
        ({"/pack.json": "{}"}, "leads out of the archive"),
        ({"pack.json": "[]"}, "was not written by cm build pack"),
        ({"pack.json": "{"}, "was not written by cm build pack"),
        ({"pack.json": '{"version": 2, "project": "x", "steps": [], "files": {}}'}, "version 2"),
        ({"pack.json": '{"version": 1, "project": "x", "steps": ["gone"], "files": {}}'}, "no step gone any more"),
    ],
)
def test_what_is_not_a_packed_flow_is_refused(files: dict[str, str], said: str, tmp_path: Path) -> None:
    _, out = made(tmp_path / "p")
    with pytest.raises(BuildError) as caught:
        unpack(archive_of(tmp_path, **files), out)
    assert said in str(caught.value)
    assert [path.name for path in out.parent.iterdir() if path.name.startswith(".cm-unpack")] == []


def test_a_file_that_is_not_an_archive_is_refused(tmp_path: Path) -> None:
    _, out = made(tmp_path / "p")
    (tmp_path / "back.tar.gz").write_bytes(b"no archive")
    with pytest.raises(BuildError, match="cannot be read"):
        unpack(tmp_path / "back.tar.gz", out)
