# SPDX-License-Identifier: Apache-2.0
"""Vivado's utilisation reports give the advisor each module's resources."""

from __future__ import annotations

import contextlib
import json
import re
from pathlib import Path

import pytest
from build_support import copy_examples
from hypothesis import given, settings
from hypothesis import strategies as st

from cm.cli.main import main
from cm.design.errors import BuildError
from cm.design.partition.utilisation import parse_utilisation
from cm.design.project.model import Resources

SERIES_7 = """\
| Design       : top
+----------------------------+------+-------+-----------+-------+
|          Site Type         | Used | Fixed | Available | Util% |
+----------------------------+------+-------+-----------+-------+
| Slice LUTs*                | {lut} |     0 |     53200 |  2.11 |
|   LUT as Logic             |    7 |     0 |     53200 |  2.00 |
| Slice Registers            |  900 |     0 |    106400 |  0.85 |
+----------------------------+------+-------+-----------+-------+
* Warning! The Final LUT count, after physical optimizations, is typically lower.

|    Site Type   | Used | Fixed | Available | Util% |
| Block RAM Tile |  2.5 |     0 |       140 |  1.79 |
|   RAMB36/FIFO* |    2 |     0 |       140 |  1.43 |

| Site Type | Used | Fixed | Available | Util% |
| DSPs      |    4 |     0 |       220 |  1.82 |

| Ref Name | Used | Functional Category |
| DSPs     |   99 |                 LUT |
"""
ULTRASCALE = """\
|       Site Type       | Used | Fixed | Prohibited | Available | Util% |
| CLB LUTs*             | 5365 |     0 |          0 |    117120 |  4.58 |
| CLB Registers         | 6171 |     0 |          0 |    234240 |  2.63 |
|       Site Type       | Used | Fixed | Prohibited | Available | Util% |
| Block RAM Tile        |   10 |     0 |          0 |       144 |  6.94 |
|       Site Type       | Used | Fixed | Prohibited | Available | Util% |
| DSPs                  |    0 |     0 |          0 |      1248 |  0.00 |
"""


def test_both_families_are_read() -> None:
    assert parse_utilisation(SERIES_7.format(lut=1123)) == Resources(1123, 900, 2.5, 4)
    assert parse_utilisation(ULTRASCALE) == Resources(5365, 6171, 10, 0)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "no row for LUTs, registers, Block RAM Tile, DSPs"),
        (ULTRASCALE.replace("| DSPs  ", "| DPSs  "), "no row for DSPs"),
        (ULTRASCALE.replace("5365", "many"), "CLB LUTs: 'many' is not a number"),
    ],
)
def test_what_is_not_a_report_is_refused(text: str, reason: str) -> None:
    with pytest.raises(BuildError, match=reason):
        parse_utilisation(text, "a.rpt")


@settings(max_examples=60, deadline=None)
@given(st.text(alphabet="| \nUsedSiteTypLUTCB*0123456789.", max_size=400), st.integers(0, 900))
def test_any_damage_is_read_or_refused(noise: str, where: int) -> None:
    text = SERIES_7.format(lut=1)
    with contextlib.suppress(BuildError):
        parse_utilisation(text[:where] + noise + text[where:])


def test_the_advisor_uses_reports_and_the_schema_takes_precedence(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    folder = copy_examples(tmp_path) / "camera"
    schema = folder / "build.yaml"
    text = re.sub(r"    resources: .*\n", "", schema.read_text())
    schema.write_text(text.replace("    top: camera_edge\n", "    top: camera_edge\n    resources: {lut: 5000}\n"))
    assert main(["build", "partition", str(schema)]) == 1
    assert "resources: is missing for default, colorise" in capsys.readouterr().err
    reports = folder / "build/reports"
    reports.mkdir(parents=True)
    for name, lut in (("default", 1000), ("edge", 20000), ("colorise", 2000)):
        (reports / f"synth_{name}.utilization.rpt").write_text(SERIES_7.format(lut=lut))
    assert main(["build", "partition", str(schema), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert sorted(said["reports"]) == ["colorise", "default"]
    (region,) = said["today"]["regions"]
    # 5000 LUTs and a fifth more, of 53200, in steps of 1/64
    assert region["share"] == pytest.approx(8 / 64)
    alone = said["today"]["share"]
    (reports / "static_synth.utilization.rpt").write_text(SERIES_7.format(lut=5320))
    assert main(["build", "partition", str(schema), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["reports"]["static part"].endswith("static_synth.utilization.rpt")
    assert said["today"]["share"] == pytest.approx(alone + 0.1)
