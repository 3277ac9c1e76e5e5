# SPDX-License-Identifier: Apache-2.0
"""Generated Tcl, without Vivado: linted with a schema of every command, and replayed with recorded commands."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from build_support import NAMES, copy_examples, generated, needs, project

from cm.design.generate.generation import generate, load_design, output_folder
from cm.design.render import tcl_word

TCL = Path(__file__).parents[2] / "tcl"
COMMANDS = TCL / "vivado_commands.json"


@pytest.fixture(scope="module", params=NAMES)
def out(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return generated(copy_examples(tmp_path_factory.mktemp("tcl")), request.param)[1]


def known_commands() -> str:
    commands = json.loads(COMMANDS.read_text())["commands"]
    lines = []
    for name, entry in commands.items():
        switches = [f"{switch}={int(spec['value'] is not None)}" for switch, spec in entry["switches"].items()]
        lines.append(" ".join([name, *switches]))
    return "\n".join(lines) + "\n"


def replay(out: Path, script: str, tmp_path: Path, **environment: str) -> tuple[int, str, list[str]]:
    """Exit status, stderr, and the recorded calls."""
    (tmp_path / "known").write_text(known_commands())
    record = tmp_path / "record"
    # the scripts write below the folder that they run in, and read what lies beside the build schema
    work = tmp_path / "work" / out.parent.name / out.name
    if not work.exists():
        shutil.copytree(out.parent.parent, tmp_path / "work")
    command = ["tclsh", str(TCL / "replay.tcl"), str(tmp_path / "known"), str(record), script]
    done = subprocess.run(command, cwd=work, capture_output=True, text=True, env=os.environ | environment, check=False)
    return done.returncode, done.stderr, record.read_text().splitlines()


def scripts(out: Path) -> list[str]:
    """The scripts in the order in which the flow runs them: each reads what earlier ones wrote."""
    return [f"tcl/step_{step['name']}.tcl" for step in json.loads((out / "steps.json").read_text())["steps"]]


def before(out: Path, script: str, tmp_path: Path) -> None:
    """Replay the flow up to `script`."""
    for earlier in scripts(out)[: scripts(out).index(script)]:
        status, said, _ = replay(out, earlier, tmp_path)
        assert status == 0, f"{earlier}: {said}"


def after_all(out: Path, script: str, tmp_path: Path, **environment: str) -> tuple[int, str, list[str]]:
    """Replay `script` after the steps before it."""
    before(out, script, tmp_path)
    return replay(out, script, tmp_path, **environment)


def test_tclint_accepts_every_script(out: Path) -> None:
    pytest.importorskip("tclint", reason="needs tclint, which is not installed")
    files = [*sorted((out / "tcl").glob("*.tcl")), *sorted((out / "constraints").glob("*.xdc"))]
    command = [
        sys.executable,
        "-m",
        "tclint",
        "--commands",
        str(COMMANDS),
        "--style-line-length",
        "400",
        *map(str, files),
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_tclint_would_see_an_abbreviated_switch(tmp_path: Path) -> None:
    pytest.importorskip("tclint", reason="needs tclint, which is not installed")
    script = tmp_path / "wrong.tcl"
    script.write_text("update_design -cell a -black_box\n")
    command = [sys.executable, "-m", "tclint", "--commands", str(COMMANDS), str(script)]
    assert subprocess.run(command, capture_output=True, check=False).returncode == 1


@needs("tclsh")
def test_every_step_replays_with_known_commands_only(out: Path, tmp_path: Path) -> None:
    for script in scripts(out):
        status, said, calls = replay(out, script, tmp_path)
        assert status == 0, f"{script}: {said}"
        assert calls


@needs("tclsh")
def test_the_static_part_is_locked_after_the_first_run_only(out: Path, tmp_path: Path) -> None:
    for script in scripts(out):
        _, _, calls = replay(out, script, tmp_path)
        if not re.search(r"step_run_\d", script):
            continue
        first = script == "tcl/step_run_1.tcl"
        assert ("lock_design -level routing" in calls) is first
        base = "static_synth" if first else "static_routed"
        assert [call for call in calls if call.startswith("open_checkpoint")] == [
            f"open_checkpoint checkpoints/{base}.dcp"
        ]


@needs("tclsh")
@pytest.mark.parametrize(
    ("script", "environment", "words"),
    [
        ("system", {"CM_NO_BOARD": "1"}, "no board files for .*XilinxBoardStore"),
        ("verify", {"CM_PR_VERIFY": "0"}, "do not agree on the static part"),
        ("run_2", {"CM_SLACK": "-0.25"}, "misses timing"),
        ("run_1", {"CM_SLACK": "-0.01", "CM_KIND": "hold"}, "worst hold slack -0.01"),
        ("run_1", {"CM_PULSE_WIDTH": "1"}, "pulse_width.rpt"),
        ("run_1", {"CM_DRC": "NSTD-1"}, r"breaks 1 design rules \(NSTD-1\)"),
    ],
)
def test_what_goes_wrong_in_a_step_ends_the_flow(
    script: str, environment: dict[str, str], words: str, out: Path, tmp_path: Path
) -> None:
    status, said, calls = after_all(out, f"tcl/step_{script}.tcl", tmp_path, **environment)
    assert status == 1
    assert re.search(words, said, re.DOTALL)
    assert not [call for call in calls if call.startswith("write_checkpoint")]


@needs("tclsh")
def test_bitstreams_are_whole_where_the_hardware_platform_cannot_be_written(out: Path, tmp_path: Path) -> None:
    status, said, calls = after_all(out, "tcl/step_bitstreams_run_1.tcl", tmp_path, CM_NO_XSA="1")
    assert status == 0, said
    assert [call for call in calls if call.startswith("write_bitstream")]


@needs("tclsh")
def test_a_flow_without_the_block_designs_wrapper_says_what_is_missing(out: Path, tmp_path: Path) -> None:
    before(out, "tcl/step_static.tcl", tmp_path)
    for path in (tmp_path / "work").rglob("cm_system_wrapper.v"):
        path.unlink()
    status, said, _ = replay(out, "tcl/step_static.tcl", tmp_path)
    assert status == 1
    assert "no wrapper of the block design" in said


@needs("tclsh")
@pytest.mark.parametrize(
    ("line", "spoiled", "message"),
    [
        (r"set_property CONFIG.FREQ_HZ \S+ \[get_bd_intf_ports m_axi_\w+\]", "", "BD 41-237"),
        (r"set_property CONFIG.ASSOCIATED_BUSIF .*", "", "BD 41-967"),
        (r"connect_bd_net \S+ \S+ \[get_bd_pins dma_icap/m_axi_sg_aclk\]", "", "BD 41-758"),
        (r"set_property CONFIG.NUM_MI .*", "", "BD 5-232"),
        (
            r"set_property CONFIG.PCW_EN_CLK0_PORT .*|set_property CONFIG.PSU__FPGA_PL0_ENABLE .*",
            "",
            "BD 41-701",
        ),
        (r"-offset 0x\w+", "-offset 0x40000004", "BD 41-1075"),
        (r"-range 65536", "-range 65540", "BD 41-1075"),
        (r"-offset 0x(4|A)4000000", r"-offset 0x\g<1>0000000", "BD 41-971"),
        (r"c_sg_length_width \{26\}", "c_sg_length_width {27}", "IP_Flow 19-3461"),
    ],
)
def test_a_block_design_that_vivado_would_refuse_is_refused(
    line: str, spoiled: str, message: str, out: Path, tmp_path: Path
) -> None:
    """Each mistake is put into the generated file, which passes without it."""
    assert replay(out, "tcl/step_system.tcl", tmp_path)[0] == 0
    script = tmp_path / "work" / out.parent.name / out.name / "tcl/block_design.tcl"
    text, count = re.subn(line, spoiled, script.read_text(), count=1)
    assert count
    if "FREQ_HZ" in line:  # a rate that the dividers cannot produce
        text = text.replace("FREQMHZ {100}", "FREQMHZ {99.5}")
    script.write_text(text)
    status, said, _ = replay(out, "tcl/step_system.tcl", tmp_path)
    assert status == 1
    assert message in said


@needs("tclsh")
@pytest.mark.parametrize(
    ("file", "line", "spoiled", "message"),
    [
        ("step_run_1", r"read_checkpoint -cell .*", "", "DRC INBB-3"),
        ("floorplan", r"(?<=SNAPPING_MODE ON )\[get_pblocks \w+\]", "[get_pblocks other]", "Common 17-55"),
    ],
)
def test_a_run_that_vivado_would_refuse_is_refused(
    file: str, line: str, spoiled: str, message: str, out: Path, tmp_path: Path
) -> None:
    step = "tcl/step_run_1.tcl"
    before(out, step, tmp_path)
    script = tmp_path / "work" / out.parent.name / out.name / f"tcl/{file}.tcl"
    text, count = re.subn(line, spoiled, script.read_text(), count=1)
    if not count:  # UltraScale+ snaps without being told, and has nothing there that could be spoiled
        assert "SNAPPING_MODE" not in script.read_text()
        return
    script.write_text(text)
    status, said, _ = replay(out, step, tmp_path)
    assert status == 1
    assert message in said


@needs("tclsh")
def test_regions_placed_by_the_tool_never_overlap(out: Path, tmp_path: Path) -> None:
    _, _, calls = after_all(out, "tcl/step_run_1.tcl", tmp_path)
    placed = [call for call in calls if call.startswith("resize_pblock")]
    assert len(placed) == len(set(placed)) >= 1


@needs("tclsh")
def test_a_region_that_fits_nowhere_is_an_error(tmp_path: Path) -> None:
    text = """\
        project: {name: small, part: xc7z020clg400-1}
        regions:
          prr0: {pblock: auto, resources: {lut: 53100}}
        modules:
          one: {sources: [one.v]}
        """
    pytest.importorskip("pyslang", reason="needs pyslang: the extra [build] is not installed")
    (tmp_path / "p").mkdir()
    design = load_design(project(tmp_path / "p", text))
    out = output_folder(design.project, None)
    generate(design, out)
    status, said, _ = after_all(out, "tcl/step_run_1.tcl", tmp_path)
    assert status == 1
    assert "no rectangle of clock regions is free" in said


@needs("tclsh")
@pytest.mark.parametrize(
    "text", ["plain", "two words", "a$b", "[exit]", 'q"uote', "back\\slash", "{brace", "tab\t", "#x"]
)
def test_any_text_is_one_word_of_tcl(text: str, tmp_path: Path) -> None:
    script = tmp_path / "word.tcl"
    script.write_text(f"proc show {{word}} {{ puts -nonewline $word }}\nshow {tcl_word(text)}\n")
    assert subprocess.run(["tclsh", script], capture_output=True, text=True, check=True).stdout == text
