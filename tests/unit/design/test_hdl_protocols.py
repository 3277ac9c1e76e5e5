# SPDX-License-Identifier: Apache-2.0
"""The user's own protocols, and IP-XACT."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("pyslang")

from hdl_support import DATA, extract, ports

from cm.design.hdl.compare_ipxact import compare
from cm.design.hdl.errors import HdlError
from cm.design.hdl.ipxact import load_component_xml
from cm.design.hdl.model import FoundBy, Language, Mode, Polarity
from cm.design.hdl.user_protocols import load_protocols, parse_protocols
from cm.schema.problems import SchemaError

PIXELS = "protocols:\n  - name: pixels\n    signals:\n      pix: out\n"


def test_protocols_file_finds_buses_that_names_alone_do_not_reveal() -> None:
    (sensor,) = extract([DATA / "sensor.v"], protocols=load_protocols(DATA / "protocols.yaml"))
    camera = sensor.interface("cam")
    assert (camera.protocol, camera.mode, camera.found_by) == ("pixels", Mode.MASTER, FoundBy.PROTOCOL_FILE)
    assert dict(camera.ports) == {"pix": "cam_pix", "vsync": "cam_vsync", "href": "cam_hsync", "pause": "cam_pause"}
    assert sensor.leftovers == ()


def test_binding_names_every_port_and_the_clock() -> None:
    (sensor,) = extract([DATA / "sensor.v"], protocols=load_protocols(DATA / "protocols.yaml"))
    shutter = sensor.interface("shutter")
    assert dict(shutter.ports) == {"fire": "go", "armed": "ok"}
    assert (shutter.clock, shutter.reset, shutter.reset_polarity) == ("pclk", "rst", Polarity.HIGH)


def test_binding_to_a_port_that_is_not_there_is_fatal(tmp_path: Path) -> None:
    found = ports(tmp_path, "input clk", protocols=parse_protocols(PIXELS + _binding("m", "nope"), "p.yaml"))
    assert not found.usable
    assert found.problems[0].message == "p.yaml:6:9: x: module m has no port nope"
    assert (found.problems[0].file, found.problems[0].line) == (found.file, found.line)


def _binding(module: str, port: str) -> str:
    return f"    bindings:\n      - {{module: {module}, name: x, mode: slave, ports: {{pix: {port}}}}}\n"


def test_module_with_the_other_directions_is_the_slave(tmp_path: Path) -> None:
    text = "input [9:0] x_pix; input x_vsync; input x_href; output x_pause"
    (found,) = ports(tmp_path, text, protocols=load_protocols(DATA / "protocols.yaml")).interfaces
    assert found.mode is Mode.SLAVE


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "the file is empty"),
        ("protocols: 3", r"p\.yaml:1:1: protocols: expected a list, found 3"),
        ("protocols:\n  - {name: a}", r"protocols\[0\]: signals is missing"),
        ("protocols:\n  - {name: axis, signals: {a: in}}", "axis is built in"),
        ("protocols:\n  - {name: a, signals: {}}", "at least one signal"),
        ("protocols:\n  - {name: a, signals: {b: up}}", r"p\.yaml:2:25: .*: 'up' is not one of in, out, inout"),
        ("protocols:\n  - {name: a, signals: {b: in}, extra: 1}", r"unknown key 'extra' \(known: name"),
        ("protocols:\n  - {name: a, signals: {b: {direction: in, width: 0}}}", r"0 is out of range \(at least 1\)"),
        (PIXELS + "  - {name: pixels, signals: {a: in}}", "is defined twice"),
        (
            PIXELS + "    bindings: [{module: m, name: x, mode: slave, ports: {q: a}}]",
            r"p.yaml:5:58: protocols\[0\].bindings\[0\].ports.q: pixels has no signal q; it has pix",
        ),
        (PIXELS + "    bindings: [{module: m, name: x, mode: slave, ports: {}}]", "pix must be given too"),
        ("a: [", "not YAML"),
        ("x: 1\nx: 2", "x is here again"),
    ],
)
def test_protocols_file_that_is_wrong_is_refused_with_place_and_remedy(text: str, message: str) -> None:
    with pytest.raises(SchemaError, match=message):
        parse_protocols(text, "p.yaml")


@given(st.text(max_size=200) | st.from_regex(r"protocols:\n  - \{name: [a-z]{0,3}, signals: [a-z0-9{}:, \[\]]{0,30}\}"))
def test_protocols_file_of_any_text_is_read_or_refused(text: str) -> None:
    try:
        parse_protocols(text)
    except SchemaError:
        return


def test_component_is_read_with_buses_clocks_resets_and_widths() -> None:
    component = load_component_xml(DATA / "tagged.xml")
    assert (component.name, component.language) == ("tagged", Language.IPXACT)
    pixels = component.interface("pixels_in")
    assert (pixels.protocol, pixels.mode, pixels.data_width) == ("axis", Mode.SLAVE, 8)
    assert (pixels.clock, pixels.reset, pixels.reset_polarity) == ("ck", "nclr", Polarity.LOW)
    assert component.clocks[0].frequency_hz == 100_000_000
    assert [left.port for left in component.leftovers] == ["gone"]
    assert component.parameters[0].value == 8


@pytest.mark.parametrize(
    ("left", "right", "width"), [("7", "4", 4), ("4", "7", 4), ("0", "0", 1), ("WIDTH", "0", None), ("7", "LOW", None)]
)
def test_a_range_of_a_component_begins_anywhere(left: str, right: str, width: int | None, tmp_path: Path) -> None:
    text = (DATA / "tagged.xml").read_text(encoding="utf-8")
    begin = text.index("<spirit:left")
    end = text.index("</spirit:right>", begin)
    vector = f"<spirit:left>{left}</spirit:left><spirit:right>{right}"
    (tmp_path / "component.xml").write_text(text[:begin] + vector + text[end:], encoding="utf-8")
    (port,) = [port for port in load_component_xml(tmp_path / "component.xml").ports if port.range]
    assert (port.range, port.width) == (f"[{left}:{right}]", width)


def test_comment_before_the_xml_declaration_is_forgiven(tmp_path: Path) -> None:
    (tmp_path / "component.xml").write_bytes(b"<!-- licence -->\n" + (DATA / "tagged.xml").read_bytes())
    assert load_component_xml(tmp_path / "component.xml").name == "tagged"


@pytest.mark.parametrize(
    ("text", "message"), [("", "not XML"), ("<a/>", "its root is <a>"), ("<a", "not XML"), ("\0\1", "not XML")]
)
def test_file_that_is_not_a_component_is_refused(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "c.xml").write_text(text)
    with pytest.raises(HdlError, match=message):
        load_component_xml(tmp_path / "c.xml")


def test_differences_between_hdl_and_ipxact_are_reported() -> None:
    (tagged,) = extract([DATA / "tagged.v"])
    found = [(d.kind, d.name) for d in compare(tagged, load_component_xml(DATA / "tagged.xml"))]
    assert found[:4] == [("ports", "pixels_in"), ("extra", "pixels_out"), ("extra", "probe"), ("port", "gone")]
    assert ("port", "d") in found  # 16 bits in the HDL, 8 in IP-XACT


def test_module_does_not_differ_from_itself() -> None:
    component = load_component_xml(DATA / "tagged.xml")
    assert compare(component, component) == []


def test_interface_that_the_hdl_does_not_have_is_missing() -> None:
    component = load_component_xml(DATA / "tagged.xml")
    bare = replace(component, interfaces=())
    assert [d.kind for d in compare(bare, component)] == ["missing"]
