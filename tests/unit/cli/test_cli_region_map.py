# SPDX-License-Identifier: Apache-2.0
"""``cm region map`` of files, where no database is."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from cm.cli.main import main
from cm.formats.bitstream import FrameAddress, FrameRun, assemble

SCHEMA = """\
config:
  name: camera
  device: xc7z020
  regions: {prr0: {}, prr1: {}}
  modules:
    edge: {region: prr0, bitstream: edge.bit}
    zoom: {region: prr0, bitstream: zoom.bit}
  modes:
    default: {modules: [zoom]}
"""


@pytest.fixture
def schema(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setenv("CM_XRAY_DATABASE", str(tmp_path / "none"))
    for name, bits in (("edge", 1), ("zoom", 3)):
        data = bytes([0, 0, 0, bits]) + bytes(400 + 404)
        (tmp_path / f"{name}.bit").write_bytes(assemble("xc7z020", [FrameRun(FrameAddress(0, 0, 26), data)]))
    path = tmp_path / "camera.yaml"
    path.write_text(SCHEMA)
    return str(path)


def test_the_module_of_the_first_mode_is_drawn(schema: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["region", "map", "prr0", "--config", schema, "--svg", str(tmp_path / "map.svg")]) == 0
    out = capsys.readouterr().out
    assert "Region prr0 of camera: zoom; xc7z020, 1 frames with 2 bits set, not compared yet" in out
    assert "Project X-Ray's database is not here" in out
    assert "Region prr0 of camera: zoom" in (tmp_path / "map.svg").read_text("utf-8")


def test_frames_that_a_check_found_wrong_are_counted_and_red(
    schema: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    said = tmp_path / "said.json"
    said.write_text(json.dumps({"wrong": [{"far": 0xD00, "bits": [130]}]}))
    words = ["region", "map", "prr0", "--config", schema, "--module", "edge", "--check", str(said)]
    assert main([*words, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["module"], found["device"], found["wrong"]) == ("edge", "xc7z020", [0xD00])
    assert [(column["address"], column["bits"]) for column in found["columns"]] == [(0xD00, [1])]
    assert main([*words, "--svg", "-"]) == 0
    assert "frame 00000D00: 1 bits, wrong" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["prr9"], "has no region prr9; it has prr0, prr1"),
        (["prr1"], "region prr1 has no module"),
        (["prr0", "--module", "blur"], "region prr0 has no module blur; it has edge, zoom"),
        (["prr0", "--check", "/dev/null"], "is not what cm region check --json writes"),
        (["prr0", "--check"], "--check needs the FILE that cm region check --json wrote"),
    ],
)
def test_what_there_is_not_is_told_with_what_there_is(
    schema: str, words: list[str], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["region", "map", *words, "--config", schema]) == 1
    assert told in capsys.readouterr().err
