# SPDX-License-Identifier: Apache-2.0
"""`cm build interfaces`."""

from __future__ import annotations

import argparse
import json
from typing import Any

import pytest

pytest.importorskip("pyslang")
pytest.importorskip("tree_sitter_vhdl")

from hdl_support import DATA

from cm.cli.build_interfaces import fill_interfaces

CAMERA = (str(DATA / "camera_edge.v"), "-I", str(DATA / "include"))


def run(*words: str) -> int:
    """Run the command with these words."""
    parser = argparse.ArgumentParser()
    fill_interfaces(parser)
    args = parser.parse_args(words)
    status: int = args.run(args)
    return status


@pytest.fixture
def as_json(capsys: pytest.CaptureFixture[str]) -> Any:
    """Run with --json and parse what is printed."""

    def call(*words: str) -> Any:
        assert run(*words, "--json") == 0
        return json.loads(capsys.readouterr().out)

    return call


def test_json_of_one_module_has_interfaces_and_what_was_left_over(as_json: Any) -> None:
    found = as_json(*CAMERA, "--top", "camera_edge")
    assert found["module"] == "camera_edge"
    assert [(i["name"], i["protocol"], i["mode"], i["clock"], i["reset"]) for i in found["interfaces"]] == [
        ("s_axi", "axi4lite", "slave", "aclk", "aresetn"),
        ("s_axis", "axis", "slave", "aclk", "aresetn"),
        ("m_axis", "axis", "master", "aclk", "aresetn"),
    ]
    assert found["interfaces"][2]["ports"]["TDATA"] == "m_axis_tdata"
    assert [(left["name"], left["direction"], left["width"]) for left in found["leftover"]] == [
        ("status_leds", "out", 4)
    ]
    assert found["problems"] == []


def test_without_a_top_the_root_module_is_shown(as_json: Any) -> None:
    assert as_json(*CAMERA)["module"] == "camera_edge"


def test_all_gives_a_list_of_every_module(as_json: Any) -> None:
    assert [m["module"] for m in as_json(*CAMERA, "--all")] == ["camera_edge", "camera_edge_kernel"]


def test_parameters_and_defines_change_widths(as_json: Any) -> None:
    found = as_json(*CAMERA, "-P", "DATA_WIDTH=16", "-D", "REGISTER_BITS=8")
    assert [i["data_width"] for i in found["interfaces"]] == [32, 16, 16]
    assert found["interfaces"][0]["addr_width"] == 8


def test_own_protocols_come_from_a_file(as_json: Any) -> None:
    found = as_json(str(DATA / "sensor.v"), "--protocols", str(DATA / "protocols.yaml"))
    assert sorted(i["protocol"] for i in found["interfaces"]) == ["pixels", "trigger"]


def test_component_xml_is_read_like_a_module(as_json: Any) -> None:
    assert as_json(str(DATA / "tagged.xml"))["language"] == "ipxact"


def test_vhdl_works_alike(as_json: Any) -> None:
    assert [i["name"] for i in as_json(str(DATA / "filter.vhd"))["interfaces"]] == ["s_axis", "m_axis"]


def test_people_get_tables_and_reasons(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(str(DATA / "unflat.sv")) == 0
    text = capsys.readouterr().out
    assert "unflat (systemverilog" in text
    assert "no bus interface found" in text
    assert "needs a flat wrapper" in text


def test_output_is_the_same_every_time(capsys: pytest.CaptureFixture[str]) -> None:
    words = (str(DATA / "tagged.v"), "--json")
    run(*words)
    first = capsys.readouterr().out
    run(*words)
    assert capsys.readouterr().out == first


@pytest.mark.parametrize("words", [("-P", "WIDTH"), ("-D", "=3"), ()])
def test_wrong_usage_ends_with_status_2(words: tuple[str, ...]) -> None:
    with pytest.raises(SystemExit) as caught:
        run(*(("x.v", *words) if words else ()))
    assert caught.value.code == 2
