# SPDX-License-Identifier: Apache-2.0
"""The static part's identity: a hash of what it is made from, in its register, in the schema and in the bitstreams."""

from __future__ import annotations

import hashlib
import re
from dataclasses import replace
from pathlib import Path

import pytest
from build_support import STREAM_MODULE, copy_examples, generated, needs, project
from test_build_tcl import before, replay

from cm import schema
from cm.design.collect.collected import Collected
from cm.design.collect.collection import collect_ours
from cm.design.errors import BuildError
from cm.design.generate.generation import Design, generate, load_design
from cm.design.generate.outputs import identified, render_schema
from cm.design.runtime.answers import Answers
from cm.formats.bitstream import assemble_module
from cm.simulation.software.errors import SimError
from cm.simulation.software.hardware.board_spec import BoardSpec

pytest.importorskip("pyslang", reason="needs pyslang: the extra [build] is not installed")
pytest.importorskip("jinja2", reason="needs jinja2: the extra [build] is not installed")

TEXT = """\
project: {name: small, part: xc7z020clg400-1}
static: {sources: [mine.v], constraints: [mine.xdc], block_design: [mine.tcl]}
regions:
  prr0: {pblock: auto}
modules:
  one:
    sources: [one.v]
"""
GIVEN = {"mine.v": "module mine; endmodule\n", "mine.xdc": "# pins\n", "mine.tcl": "# more\n"}


def made(folder: Path, text: str = TEXT, module: str = STREAM_MODULE, **given: str) -> int:
    """The identity of a small project; `given`: files of its static part by name, with `_` for the dot."""
    folder.mkdir(parents=True)
    for name, content in (GIVEN | {name.replace("_", "."): content for name, content in given.items()}).items():
        (folder / name).write_text(content)
    path = project(folder, text, one=module.format(name="one", high=31))
    return identified(load_design(path).system).static_identity


def test_the_same_sources_give_the_same_identity_wherever_they_lie(tmp_path: Path) -> None:
    assert made(tmp_path / "here") == made(tmp_path / "somewhere/else entirely")


def test_the_folder_that_is_generated_to_does_not_count(tmp_path: Path) -> None:
    design, out = generated(copy_examples(tmp_path), "camera")
    elsewhere = tmp_path / "a/b/c/out"
    generate(design, elsewhere)
    assert (elsewhere / "hdl/cm_static.v").read_text() == (out / "hdl/cm_static.v").read_text()


@pytest.mark.parametrize("name", GIVEN)
def test_another_file_of_the_users_in_the_static_part_is_another_static_part(name: str, tmp_path: Path) -> None:
    changed = made(tmp_path / "changed", **{name.replace(".", "_"): GIVEN[name] + "\n"})
    assert changed != made(tmp_path / "plain")


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("xc7z020clg400-1", "xc7z020clg400-2"),
        ("part: xc7z020clg400-1", 'part: xc7z020clg400-1, vivado: "2023.2"'),
        ("static: {", "static: {revision: 2, "),
        ("{pblock: auto}", '{pblock: "SLICE_X0Y0:SLICE_X49Y49"}'),
        ("{pblock: auto}", "{pblock: auto, decoupling: false}"),
        ("regions:", "clocks: {fast: {rate: 50000000}}\nregions:"),
    ],
)
def test_another_setting_of_the_static_part_is_another_static_part(old: str, new: str, tmp_path: Path) -> None:
    assert old in TEXT
    assert made(tmp_path / "changed", TEXT.replace(old, new)) != made(tmp_path / "plain")


def test_a_module_may_change_within_its_region(tmp_path: Path) -> None:
    changed = made(tmp_path / "changed", module=STREAM_MODULE + "// changed\n")
    assert changed == made(tmp_path / "plain")


def test_register_and_runtime_schema_have_the_same_identity(tmp_path: Path) -> None:
    design, out = generated(copy_examples(tmp_path), "two_regions")
    static = schema.load(out / "config/two_regions.yaml").static
    found = re.search(r"\.STATIC_ID\(32'h(\w{8})\)", (out / "hdl/cm_static.v").read_text())
    assert static is not None
    assert found is not None
    assert static.identity == int(found[1], 16) == identified(design.system).static_identity
    assert (static.base_address, static.offset, static.width) == (design.system.control.base, 0x1C, 32)
    assert render_schema(design.system, Answers()) == (out / "config/two_regions.yaml").read_text()


@pytest.fixture
def ours(tmp_path: Path) -> tuple[Design, Path]:
    """The two-region example with bitstreams as its flow would leave them."""
    design, out = generated(copy_examples(tmp_path), "two_regions")
    (out / "bitstreams").mkdir()
    for one in design.system.implementations:
        stamp(out, one.name, assemble_module(one.name, device="xck26", region_index=one.region.index, size=4096))
    return design, out


def stamp(out: Path, name: str, data: bytes, user_id: str = "00C0FFEE") -> None:
    assert b"UserID=0XFFFFFFFF" in data
    (out / f"bitstreams/{name}.bit").write_bytes(data.replace(b"UserID=0XFFFFFFFF", b"UserID=0X" + user_id.encode()))


def gather(design: Design, out: Path) -> Collected:
    return collect_ours([out / "bitstreams"], design.system, Answers(), out)


def test_the_collected_schema_has_the_identity_and_the_user_id_of_the_flow(ours: tuple[Design, Path]) -> None:
    static = gather(*ours).config.static
    assert static is not None
    assert (static.identity, static.user_id) == (identified(ours[0].system).static_identity, 0x00C0FFEE)


@pytest.mark.parametrize("other", ["00C0FFEF", "FFFFFFFF"])
def test_bitstreams_of_two_runs_are_not_collected_together(other: str, ours: tuple[Design, Path]) -> None:
    stamp(ours[1], "gain", assemble_module("gain", device="xck26", region_index=1, size=4096), other)
    with pytest.raises(BuildError, match=r"several runs of the flow, by their USERID: .*: gain\.bit"):
        gather(*ours)


def test_bitstreams_of_another_run_than_the_one_that_is_here_are_refused(ours: tuple[Design, Path]) -> None:
    checkpoints = ours[1] / "checkpoints"
    checkpoints.mkdir()
    (checkpoints / "static_routed.dcp").write_bytes(b"another run")
    expected = hashlib.sha256(b"another run").hexdigest()[:8].upper()
    with pytest.raises(BuildError, match=rf"their USERID is 00C0FFEE, .*static_routed\.dcp gives {expected}"):
        gather(*ours)


def test_files_without_a_header_are_reported(ours: tuple[Design, Path]) -> None:
    for path in (ours[1] / "bitstreams").glob("*.bit"):
        path.with_suffix(".bin").write_bytes(path.read_bytes()[path.read_bytes().index(b"\xff" * 32) :])
        path.unlink()
    found = gather(*ours)
    assert found.config.static is not None
    assert found.config.static.user_id is None
    assert any("no header, so the run that made it is not known" in note for note in found.notes)


def test_a_static_part_that_was_generated_from_other_sources_is_not_collected(ours: tuple[Design, Path]) -> None:
    path = ours[0].project.source
    path.write_text(path.read_text() + "static: {revision: two}\n")
    with pytest.raises(BuildError, match=r"cm_static\.v is of another static part: its identity is 0x"):
        gather(load_design(path), ours[1])


@needs("tclsh")
def test_bitstreams_of_every_run_get_the_user_id_of_the_locked_static_part(tmp_path: Path) -> None:
    """Its first digits look like a number to Tcl, which would strip the zeros."""
    _, out = generated(copy_examples(tmp_path / "examples"), "camera")
    before(out, "tcl/step_bitstreams_run_1.tcl", tmp_path)
    checkpoint = tmp_path / "work/camera/build/checkpoints/static_routed.dcp"
    number = next(n for n in range(1 << 20) if re.match(r"00\d{6}", hashlib.sha256(b"%d" % n).hexdigest()))
    checkpoint.write_bytes(b"%d" % number)
    want = f"set_property BITSTREAM.CONFIG.USERID 0x{hashlib.sha256(b'%d' % number).hexdigest()[:8]} "
    for run in (1, 2, 3):
        status, said, calls = replay(out, f"tcl/step_bitstreams_run_{run}.tcl", tmp_path)
        assert status == 0, said
        place = next(index for index, call in enumerate(calls) if call.startswith(want))
        assert place < min(index for index, call in enumerate(calls) if call.startswith("write_bitstream"))


def test_a_simulated_board_answers_the_identity_of_the_schema_or_the_one_it_is_given(tmp_path: Path) -> None:
    _, out = generated(copy_examples(tmp_path), "camera")
    config = schema.load(out / "config/camera.yaml")
    assert config.static is not None
    assert config.static.base_address is not None
    place = config.static.base_address + config.static.offset
    board = BoardSpec.from_configs([config])
    assert [one.reset for one in board.registers if one.address == place] == [config.static.identity]
    assert [one.reset for one in board.with_static(7).registers if one.address == place] == [7]
    with pytest.raises(SimError, match="does not fit"):
        board.with_static(1 << 32)
    with pytest.raises(SimError, match="no configuration says"):
        BoardSpec.from_configs([replace(config, static=None)]).with_static(7)
