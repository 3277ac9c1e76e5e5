# SPDX-License-Identifier: Apache-2.0
"""A mistake for each message of Vivado that users report in public, caught by `cm build check` before Vivado sees it.

The messages of the block design and of the runs are in test_build_tcl.py; docs/build-vivado.md says where each
is public.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from build_support import MINIMAL, STREAM_MODULE, project

from cm.cli.main import main

pytest.importorskip("pyslang", reason="needs pyslang: the extra [build] is not installed")

HERE = Path(__file__).parent
PAGE = HERE.parents[2] / "docs/build-vivado.md"
GOOD = STREAM_MODULE.format(name="one", high=31)
PLACED = MINIMAL.replace("pblock: auto", "pblock: [SLICE_X26Y50:SLICE_X43Y99, RAMB36_X2Y10:RAMB36_X2Y19]")
EXTERNAL = MINIMAL.replace("{pblock: auto}", "{pblock: auto, interfaces: {m_axis: {connect: external}}}")
TWO_CLOCKS = "clocks: {fclk0: {rate: 100_000_000}, fclk1: {rate: 50_000_000}}\n"
CROSSED = TWO_CLOCKS + MINIMAL.replace("{pblock: auto}", "{pblock: auto, clocks: {aclk: external}}")


def body(text: str) -> str:
    return GOOD.replace("endmodule", f"    {text}\nendmodule")


def needing(resources: str) -> str:
    return PLACED.replace("sources: [one.v]", f"sources: [one.v]\n    resources: {resources}")


MISTAKES = [
    ("Synth 8-439", MINIMAL, {"one": body("missing m ();")}, "no file has missing, which one needs below it"),
    ("Synth 8-448", MINIMAL, {"one": body("inner i (.b(clk));") + "module inner (input wire a); endmodule\n"}, "'b'"),
    ("Synth 8-1031", MINIMAL, {"one": body("wire w = nothere[1];")}, "use of undeclared identifier 'nothere'"),
    (
        "Synth 8-6735",
        MINIMAL.replace("[one.v]", "[before.v, one.v]"),
        {"before": "`default_nettype none\n", "one": GOOD.replace("input  wire        clk", "input clk")},
        "clk",
    ),
    ("DRC UCIO-1", EXTERNAL, {}, "has no pin"),
    ("DRC NSTD-1", EXTERNAL, {}, "has no pin"),
    ("Place 30-58", EXTERNAL, {}, "has no pin"),
    ("DRC HDPR-18", needing("{dsp: 3}"), {}, "module one needs 3 DSP, the pblock of prr0 has 0"),
    ("DRC UTLZ-1", needing("{bram: 11}"), {}, "module one needs 11 block RAM"),
    ("Place 30-640", needing("{lut: 3601}"), {}, "module one needs 3601 LUT"),
    ("BD 41-237", CROSSED, {}, "its decoupler runs on fclk0"),
]


@pytest.mark.parametrize(("message", "schema", "files", "said"), MISTAKES, ids=[mistake[0] for mistake in MISTAKES])
def test_a_mistake_that_vivado_answers_with_a_message_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture, message: str, schema: str, files: dict[str, str], said: str
) -> None:
    assert main(["build", "check", str(project(tmp_path, MINIMAL))]) == 0
    capsys.readouterr()
    assert main(["build", "check", str(project(tmp_path, schema, **files))]) == 1
    caught = capsys.readouterr()
    text = caught.out + caught.err
    assert said in text
    # with the place: a file with its line
    assert re.search(r"(one\.v|build\.yaml):\d+", text)


def test_every_message_that_the_page_lists_has_its_mistake() -> None:
    listed = set(
        re.findall(r"^\| ((?:BD|DRC|Synth|Place|IP_Flow|Common) [\w-]+)", PAGE.read_text("utf-8"), re.MULTILINE)
    )
    tests = "".join(path.read_text("utf-8") for path in sorted(HERE.glob("test_build_*.py")))
    assert {number for number in listed if number not in tests} == set()
    assert len(listed) > 15
