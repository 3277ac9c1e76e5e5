# SPDX-License-Identifier: Apache-2.0
"""The camera example of the package, and the meaning of a configuration."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

import cm.schema
from cm.errors import NotFound
from cm.schema import SchemaError
from cm.schema.model import Access, Config, Direction, LoaderKind
from cm.schema.named_files import FileMissing, bitstream_path, overlay_path

CAMERA = Path(cm.schema.__file__).parents[1] / "data" / "camera" / "camera.yaml"


@pytest.fixture(scope="module")
def camera() -> Config:
    return cm.schema.load(CAMERA)


def loads(body: str) -> Config:
    return cm.schema.loads("config:\n" + "\n".join(f"  {line}" for line in body.splitlines()))


def test_the_camera_has_its_modes_and_regions(camera: Config) -> None:
    assert list(camera.modes) == ["default", "edge_detection", "colorise", "loopback", "loopback_edge"]
    assert camera.first_mode() == "default"
    assert list(camera.regions) == ["prr0", "prr1"]
    assert {module.region for module in camera.modules.values()} == {"prr0", "prr1"}
    assert len({module.identity for module in camera.modules.values()}) == len(camera.modules)


def test_a_mode_changes_a_stream_and_keeps_the_rest(camera: Config) -> None:
    grey, colour = (camera.modes[mode].streams["camera"] for mode in ("default", "colorise"))
    assert (grey.shape, colour.shape) == ((480, 640), (480, 640, 3))
    assert (colour.direction, colour.slots, colour.rate) == (Direction.S2MM, 8, 30.0)


def test_registers_of_a_module_are_visible_in_its_modes_only(camera: Config) -> None:
    assert "threshold" in camera.visible_registers("edge_detection")
    assert "threshold" not in camera.visible_registers("default")
    assert camera.visible_registers("edge_detection")["threshold"].address == 0x3018
    assert camera.visible_registers("default")["focus"].region == "prr0"
    assert camera.registers["version"].region is None
    assert camera.registers["irq_status"].access is Access.W1C


def test_bits_and_lsb_are_equivalent() -> None:
    config = loads(
        "name: c\nmodes: {m: {}}\nmmio:\n- base_address: 0\n  registers:\n    r:\n      offset: 0\n"
        "      fields: {a: {bits: 7:4}, b: {bits: '9'}, c: {bits: 10}, d: {lsb: 11, width: 2}}\n"
    )
    fields = config.registers["r"].fields.values()
    assert [(field.lsb, field.width) for field in fields] == [(4, 4), (9, 1), (10, 1), (11, 2)]


def test_a_mode_may_change_the_default_of_a_register() -> None:
    config = loads(
        "name: c\nmmio: [{base_address: 0, registers: {r: {offset: 0, default: 1}}}]\n"
        "modes:\n  m: {mmio: [{base_address: 0, registers: {r: {offset: 0, default: 2}}}]}\n  n: {}\n"
    )
    assert [config.visible_registers(mode)["r"].default for mode in ("m", "n")] == [2, 1]


def test_different_modes_may_use_one_address_for_different_registers() -> None:
    config = loads(
        "name: c\nmodes:\n  m: {mmio: [{base_address: 0, registers: {r: {offset: 0}}}]}\n"
        "  n: {mmio: [{base_address: 0, registers: {s: {offset: 0}}}]}\n"
    )
    assert config.modes["m"].registers["r"].address == config.modes["n"].registers["s"].address


@pytest.mark.parametrize(
    ("modules", "said", "region"),
    [
        ("[a]", "", "left"),
        ("[a, b]", "", None),
        ("[]", "", None),
        ("[a]", "region: right, ", "right"),
        ("[a]", "region: static, ", None),
    ],
)
def test_the_region_of_a_register_of_a_mode(modules: str, said: str, region: str | None) -> None:
    config = loads(
        "name: c\nregions: [left, right]\nmodules: {a: {region: left}, b: {region: right}}\n"
        f"modes: {{m: {{modules: {modules}, mmio: [{{{said}base_address: 0, registers: {{r: {{offset: 0}}}}}}]}}}}\n"
    )
    assert config.modes["m"].registers["r"].region == region


@pytest.mark.parametrize(
    ("word", "direction"),
    [("mm2s", "mm2s"), ("write", "mm2s"), ("tx", "mm2s"), ("s2mm", "s2mm"), ("read", "s2mm"), ("rx", "s2mm")],
)
def test_directions_have_alternative_names(word: str, direction: str) -> None:
    stream = loads(f"name: c\nmodes: {{m: {{}}}}\nstreams: {{s: {{direction: {word}}}}}").streams["s"]
    assert (stream.direction.value, stream.channel) == (direction, "s")


def test_a_full_configuration_needs_no_regions_and_no_modes() -> None:
    config = loads("name: c\ntype: full\nbitstream: x.bit\nloader: icap\ntimeout: 2\nclocks: {fclk0: 100_000_000}")
    assert (list(config.regions), list(config.modes), config.loader) == ([], ["default"], LoaderKind.ICAP)
    assert config.clocks["fclk0"].rate == 100_000_000


def test_a_stream_may_exist_in_one_mode_only() -> None:
    config = loads("name: c\nmodes: {m: {streams: {s: {direction: s2mm}}}, n: {}}")
    assert (list(config.modes["m"].streams), list(config.modes["n"].streams)) == (["s"], [])


def test_a_configuration_cannot_be_changed(camera: Config) -> None:
    with pytest.raises(TypeError):
        camera.modes["x"] = camera.modes["default"]  # type: ignore[index]
    with pytest.raises(AttributeError):
        camera.name = "x"  # type: ignore[misc]


def test_a_folder_gives_its_configurations_by_name(tmp_path: Path) -> None:
    (tmp_path / "b.yaml").write_text("config: {name: one, modes: {m: {}}}")
    (tmp_path / "a.yml").write_text("config: {name: two, modes: {m: {}}}")
    (tmp_path / "other.yaml").write_text("services: {}")
    (tmp_path / "notes.txt").write_text("config: {}")
    assert list(cm.schema.load_folder(tmp_path)) == ["two", "one"]


def test_two_files_with_one_name_are_refused_naming_both(tmp_path: Path) -> None:
    for name in ("a.yaml", "b.yaml"):
        (tmp_path / name).write_text("config: {name: one, modes: {m: {}}}")
    with pytest.raises(SchemaError) as caught:
        cm.schema.load_folder(tmp_path)
    (problem,) = caught.value.problems
    assert (problem.path, problem.code) == (tmp_path / "b.yaml", "duplicate_name")
    assert str(tmp_path / "a.yaml") in problem.message


def test_the_source_is_absolute(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "c.yaml").write_bytes(b"\xef\xbb\xbfconfig:\r\n  name: c\r\n  modes: {m: {}}\r\n")
    monkeypatch.chdir(tmp_path)
    config = cm.schema.load("c.yaml")
    assert (config.source, config.name) == (tmp_path / "c.yaml", "c")


def test_all_bad_files_in_a_folder_are_reported(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text("config: {")
    (tmp_path / "b.yaml").write_text("config: {name: 5}")
    with pytest.raises(SchemaError) as caught:
        cm.schema.load_folder(tmp_path)
    assert {problem.path for problem in caught.value.problems} == {tmp_path / "a.yaml", tmp_path / "b.yaml"}


def test_files_are_looked_for_beside_the_schema_then_under_the_firmware_folders(tmp_path: Path) -> None:
    (tmp_path / "c.yaml").write_text("config: {name: c, modules: [edge], modes: {m: {overlays: [cam]}}}")
    config = cm.schema.load(tmp_path / "c.yaml")
    firmware = tmp_path / "root" / "lib" / "firmware"
    places = [firmware / "edge.bit.bin", firmware / "cm" / "c" / "edge.bin", tmp_path / "edge.bit"]
    for place in places:  # each is preferred to those before
        place.parent.mkdir(parents=True, exist_ok=True)
        place.touch()
        assert bitstream_path(config, "edge", tmp_path / "root") == place
    (firmware / "cam.dtbo").touch()
    assert overlay_path(config, "cam", tmp_path / "root") == firmware / "cam.dtbo"


def test_a_missing_file_is_reported_with_the_places_looked_at(tmp_path: Path) -> None:
    (tmp_path / "c.yaml").write_text("config: {name: c, modules: [edge], modes: {m: {}}}")
    config = cm.schema.load(tmp_path / "c.yaml")
    with pytest.raises(
        FileMissing,
        match=r"module edge of region prr0 \(key bitstream\): no file edge\.bit \(or edge\.bin, edge\.bit\.bin\): "
        r"put it into /.*; also searched: /.*/lib/firmware/cm/c, /.*/lib/firmware$",
    ):
        bitstream_path(config, "edge", tmp_path)
    with pytest.raises(NotFound, match="did you mean edge"):
        bitstream_path(config, "edgy", tmp_path)


def test_the_model_alone_imports_no_library() -> None:
    code = "import sys, cm.schema.model; print([n for n in ('yaml', 'fastjsonschema', 'numpy') if n in sys.modules])"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=30, check=True)
    assert result.stdout == "[]\n"


def test_the_json_schema_is_valid_draft_07() -> None:
    schema = cm.schema.json_schema()
    assert schema["$schema"] == "http://json-schema.org/draft-07/schema#"
    described = [key for shape in schema["definitions"].values() for key in shape.get("properties", {}).values()]
    assert all("description" in key or "$ref" in key for key in described)
