# SPDX-License-Identifier: Apache-2.0
"""The form of the paper's Listing 1 loads character for character."""

from __future__ import annotations

from pathlib import Path

import pytest

import cm.schema
from cm.schema import SchemaError
from cm.schema.model import ConfigType, Overlay

LISTING = Path(__file__).parents[2] / "data" / "listing1.yaml"


def test_listing_1_loads_verbatim() -> None:
    config = cm.schema.load(LISTING)
    assert (config.name, config.type) == ("camera", ConfigType.PARTIAL)
    assert list(config.modules) == ["default", "edge", "colorise"]
    assert list(config.modes) == ["edge_detection", "default"]
    assert list(config.regions) == ["prr0"]
    mode = config.modes["edge_detection"]
    assert mode.modules == ("edge",)
    assert mode.overlays == (Overlay("camera"),)
    focus = mode.registers["focus"]
    assert (focus.address, focus.default, focus.region) == (0x3010, 1, "prr0")
    assert config.modes["default"].overlays == (Overlay("camera"),)
    assert config.first_mode() == "default"


def codes(text: str) -> list[tuple[str, str]]:
    with pytest.raises(SchemaError) as caught:
        cm.schema.loads(text)
    return [(problem.code, problem.key) for problem in caught.value.problems]


def test_a_mode_that_occurs_twice_among_siblings_is_reported() -> None:
    text = "config:\n- name: c\n- modes:\n  a:\n  - doc: x\n  a:\n  - doc: y\n"
    assert codes(text) == [("duplicate_name", "config.modes.a")]


def test_a_key_that_occurs_twice_in_a_list_is_reported() -> None:
    text = "config:\n- name: c\n- name: d\n- modes:\n  a: []\n"
    assert codes(text) == [("duplicate_key", "config.name")]


def test_overlays_that_occur_twice_inside_mmio_are_reported() -> None:
    text = "config: {name: c, modes: {m: {mmio: [{base_address: 0, registers: {}, overlay: a, overlay: b}]}}}"
    assert codes(text) == [("duplicate_key", "config.modes.m.mmio[0].overlay")]


def test_an_entry_of_a_list_that_is_not_a_map_is_reported() -> None:
    assert codes("config:\n- name: c\n- 5\n- modes:\n  a: []\n") == [("bad_type", "config")]


@pytest.mark.parametrize(
    "mmio",
    [
        "{base_address: 0, registers: {r: {offset: 0}}}",
        "[{base_address: 0, registers: {r: {offset: 0}}}]",
        "[base_address: 0, registers: [r: [offset: 0]]]",
        "[{base_address: 0}, {registers: , r: {offset: 0}}]",
        "[base_address: 0, overlay: camera, registers: {r: {offset: 0}}]",
    ],
)
def test_forms_of_a_window_mean_the_same(mmio: str) -> None:
    config = cm.schema.loads(f"config: {{name: c, modes: {{m: {{mmio: {mmio}}}}}}}")
    assert config.modes["m"].registers["r"].address == 0


def test_windows_follow_each_other_as_one_key_maps() -> None:
    window = "base_address: {0}, registers: {{r{0}: {{offset: 0}}}}"
    config = cm.schema.loads(f"config: {{name: c, modes: {{m: }}, mmio: [{window.format(0)}, {window.format(8)}]}}")
    assert [register.address for register in config.registers.values()] == [0, 8]


def test_overlays_of_a_mode_and_of_its_mmio_are_joined() -> None:
    mmio = "[base_address: 0, registers: {}, overlay: [b, c]]"
    config = cm.schema.loads(f"config: {{name: c, modes: {{m: {{overlay: a, mmio: {mmio}}}}}}}")
    assert [overlay.name for overlay in config.modes["m"].overlays] == ["a", "b", "c"]
