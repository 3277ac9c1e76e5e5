# SPDX-License-Identifier: Apache-2.0
"""`cm build interfaces`."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("pyslang")
pytest.importorskip("tree_sitter_vhdl")

from hdl_support import DATA
from import_support import hwh, module, port, ports

from cm.cli.build_interfaces import fill_interfaces
from cm.cli.main import main

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


def test_a_hardware_handoff_tells_the_buses_of_its_ips(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Each port map as Vivado has it, whatever its ports are called; a rate and a sensitivity go with their signals."""
    names = {"TDATA": "pix_q", "TVALID": "pix_v", "TREADY": "pix_stop_n"}
    mapped = "".join(f'<PORTMAP LOGICAL="{signal}" PHYSICAL="{name}"/>' for signal, name in names.items())
    bus = (
        f'<BUSINTERFACE NAME="S_PIX" TYPE="TARGET" BUSNAME="n" VLNV="xilinx.com:interface:axis:1.0"><PORTMAPS>{mapped}'
    )
    bus = f"<BUSINTERFACES>{bus}</PORTMAPS></BUSINTERFACE></BUSINTERFACES>"
    clock = port("pclk", "I", kind="clk").replace("<PORT ", '<PORT CLKFREQUENCY="1e+08" ')
    listed = [port("pix_q", "I", bits=24), port("pix_v", "I"), port("pix_stop_n", "O"), clock]
    listed += [port("gone", "O", kind="INTERRUPT", sensitivity="EDGE_RISING"), port("shift", "I", bits=3)]
    listed += [port("clear", "I", kind="rst").replace("<PORT ", '<PORT POLARITY="ACTIVE_HIGH" ')]
    (tmp_path / "d.hwh").write_bytes(hwh(module("sharp", "sharpen", ports(*listed), bus), module("bare", "none")))
    assert main(["build", "interfaces", str(tmp_path / "d.hwh"), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    (found,) = told["interfaces"]
    assert (told["module"], found["name"], found["mode"], found["found_by"]) == ("sharp", "S_PIX", "slave", "hwh")
    assert (found["ports"], found["clock"]) == (names, "pclk")
    assert told["clocks"][0]["frequency_hz"] == 100_000_000
    assert [(one["port"], one["sensitivity"]) for one in told["interrupts"]] == [("gone", "EDGE_RISING")]
    assert [(one["port"], one["polarity"], one["clock"]) for one in told["resets"]] == [("clear", "high", "pclk")]
    assert [left["name"] for left in told["leftover"]] == ["shift"]
    assert main(["build", "interfaces", str(tmp_path / "d.hwh"), "--top", "other"]) != 0
    assert "no instance other; there are: sharp, bare" in capsys.readouterr().err
    assert main(["build", "init", str(tmp_path / "d.hwh")]) != 0
    assert "describes a design that is built: cm import takes it" in capsys.readouterr().err
