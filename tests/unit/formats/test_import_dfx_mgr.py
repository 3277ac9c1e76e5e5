# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import json
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from import_support import bitstream, slot_overlay

from cm.cli.main import main
from cm.formats.bitstream import to_dma_words
from cm.formats.importers import ImportRefused, import_dfx_mgr, write
from cm.formats.importers.overlays import overlay_info
from cm.schema import dump, load, loads
from cm.schema.model import ConfigType, Decoupler, Direction, FrameRange, LoaderKind
from cm.schema.named_files import bitstream_path, overlay_path

SHELL = {"shell_type": "PL_DFX", "num_pl_slots": "2", "device_name": "a0100000.Manager", "uid": "0x12"}
ACCEL = {
    "accel_type": "SIHA_PL_DFX",
    "accel_devices": [
        {"dev_name": "80000000.AccelConfig", "reg_base": "", "reg_size": "65536"},
        {"dev_name": "81000000.rm_comm_box", "reg_base": "", "reg_size": ""},
    ],
}


def put_json(path: Path, values: dict[str, Any]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(values))


def put_accel(base: Path, name: str, slot: int, column: int, overlay: bytes | None = None, **fields: Any) -> Path:
    """``<accel>/<accel>_slot<N>`` with an image, as dfx-mgr has it."""
    folder = base / name / f"{name}_slot{slot}"
    put_json(folder / "accel.json", ACCEL | fields)
    (folder / f"{name}.bin").write_bytes(to_dma_words(bitstream(column)))
    if overlay is not None:
        (folder / f"{name}.dtbo").write_bytes(overlay)
    return folder


@pytest.fixture
def base(tmp_path: Path) -> Path:
    """A base with two slots, `aes` for both, `fft` for the first."""
    folder = tmp_path / "k26_2rp"
    put_json(folder / "shell.json", SHELL)
    (folder / "base.bit.bin").write_bytes(to_dma_words(bitstream()))
    put_accel(folder, "aes", 0, 3)
    put_accel(folder, "aes", 1, 9)
    put_accel(folder, "fft", 0, 3)
    return folder


def test_base_becomes_a_full_configuration(base: Path) -> None:
    config = import_dfx_mgr(base).configs[0]
    assert (config.name, config.type, config.device) == ("k26_2rp", ConfigType.FULL, "xc7z020")
    assert config.bitstream == base / "base.bit.bin"


def test_slots_become_regions_with_their_footprint(base: Path) -> None:
    config = import_dfx_mgr(base).configs[1]
    assert config.name == "k26_2rp_slots"
    assert config.regions["slot0"].footprint == (FrameRange(0, 0, 3, 3),)
    assert config.regions["slot1"].footprint == (FrameRange(0, 0, 9, 9),)
    assert config.regions["slot0"].loader is LoaderKind.FPGA_MANAGER


def test_accelerators_become_modules_and_modes(base: Path) -> None:
    config = import_dfx_mgr(base).configs[1]
    assert {name: module.region for name, module in config.modules.items()} == {
        "aes_slot0": "slot0",
        "aes_slot1": "slot1",
        "fft_slot0": "slot0",
    }
    assert config.modes["fft_slot0"].modules == ("fft_slot0",)


def test_devices_get_named_registers_although_sizes_are_empty(base: Path) -> None:
    imported = import_dfx_mgr(base)
    found = imported.configs[1].modules["aes_slot0"].registers
    assert {name: item.address for name, item in found.items()} == {
        "aes_slot0_accelconfig": 0x80000000,
        "aes_slot0_rm_comm_box": 0x81000000,
    }
    assert any("stand for their first words" in note for note in imported.notes)


def test_accelerator_directly_in_its_folder_is_for_slot_zero(base: Path) -> None:
    put_json(base / "fir" / "accel.json", ACCEL)
    (base / "fir" / "fir.bin").write_bytes(to_dma_words(bitstream(3)))
    assert import_dfx_mgr(base).configs[1].modules["fir"].region == "slot0"


def test_image_is_found_although_the_overlay_names_another(base: Path) -> None:
    put_accel(base, "fir", 0, 3, slot_overlay(0, "fir.bit.bin"))
    imported = import_dfx_mgr(base)
    found = imported.configs[1].modules["fir_slot0"].bitstream
    assert found is not None
    assert found.name == "fir.bin"
    assert any("names fir.bit.bin, the folder has fir.bin" in note for note in imported.notes)


def test_overlay_that_only_loads_is_not_needed(base: Path) -> None:
    put_accel(base, "fir", 0, 3, slot_overlay(0, "fir.bin"))
    imported = import_dfx_mgr(base)
    assert imported.configs[1].regions["slot0"].loader is LoaderKind.FPGA_MANAGER
    assert imported.configs[1].modes["fir_slot0"].overlays == ()
    assert imported.links == {}


def test_overlay_that_loads_and_adds_devices_is_the_loader(base: Path, tmp_path: Path) -> None:
    folder = put_accel(base, "fir", 1, 9, slot_overlay(1, "fir.bin", device=True))
    imported = import_dfx_mgr(base)
    assert imported.configs[1].regions["slot1"].loader is LoaderKind.OVERLAY
    write(imported, tmp_path / "out")
    assert (tmp_path / "out" / "fir_slot1.dtbo").resolve() == folder / "fir.dtbo"
    assert any(note.startswith("aes_slot1: others of slot 1 are loaded by their overlay") for note in imported.notes)


def test_overlay_that_only_adds_devices_belongs_to_the_mode(base: Path, tmp_path: Path) -> None:
    folder = put_accel(base, "fir", 0, 3, slot_overlay(0, None, device=True))
    files = write(import_dfx_mgr(base), tmp_path / "out")
    config = load(files[1])
    (overlay,) = config.modes["fir_slot0"].overlays
    assert overlay_path(config, overlay) == folder / "fir.dtbo"


def test_data_mover_channels_become_streams_of_the_mode(base: Path) -> None:
    channels = [{"chnl_id": "0", "chnl_dir": "S2MM"}, {"chnl_id": 1, "chnl_dir": "MM2S"}, {"chnl_dir": "both"}]
    mover = {"dma_dev_name": "dma0", "HWType": "mcdma", "dataMoverChnls": channels}
    put_accel(base, "fir", 0, 3, dataMoverConfig=mover)
    imported = import_dfx_mgr(base)
    found = imported.configs[1].modes["fir_slot0"].streams
    assert {name: stream.direction for name, stream in found.items()} == {
        "fir_slot0_s2mm0": Direction.S2MM,
        "fir_slot0_mm2s1": Direction.MM2S,
    }
    assert any("direction 'both'" in note for note in imported.notes)


def test_isolation_of_one_bit_is_a_decoupler_that_the_value_connects(base: Path) -> None:
    """dfx-mgr writes the value to release the isolation, and 0 to assert it."""
    put_json(base / "shell.json", SHELL | {"isolation_slots": [{"offset": ["0x4000"], "values": ["0x04"]}]})
    config = import_dfx_mgr(base).configs[1]
    assert config.regions["slot0"].decoupler == Decoupler(0xA0100000, 0x4000, bit=2, active_high=False)
    assert config.regions["slot1"].decoupler is None


def test_isolation_of_several_writes_is_a_sequence(base: Path) -> None:
    """Kria's 2RP base has such a shell.json."""
    offsets, values = ["0x4000", "0x4004", "0x4008", "0x400c"], ["0x01", "0x01", "0x0b", "0x02"]
    put_json(base / "shell.json", SHELL | {"isolation_slots": [{"offset": offsets, "values": values}]})
    imported = import_dfx_mgr(base)
    found = imported.configs[1].regions["slot0"].decoupler
    assert found is not None
    assert (found.base_address, found.offset) == (0xA0100000, 0x4000)
    assert [(step.offset, step.cut, step.couple, step.verify) for step in found.sequence] == [
        (0x0, 0, 0x01, False),
        (0x4, 0, 0x01, False),
        (0x8, 0, 0x0B, False),
        (0xC, 0, 0x02, False),
    ]
    assert any("not read back" in note for note in imported.notes)
    assert loads(dump(imported.configs[1])).regions["slot0"].decoupler == found


def test_isolation_with_more_offsets_than_values_is_reported(base: Path) -> None:
    put_json(base / "shell.json", SHELL | {"isolation_slots": [{"offset": ["0x4000", "0x4004"], "values": ["1"]}]})
    imported = import_dfx_mgr(base)
    assert imported.configs[1].regions["slot0"].decoupler is None
    assert any("2 offsets and 1 values" in note for note in imported.notes)


def test_accelerator_for_other_frames_is_left_out(base: Path) -> None:
    put_accel(base, "wrong", 0, 30)
    imported = import_dfx_mgr(base)
    assert "wrong_slot0" not in imported.configs[1].modules
    assert any(
        "wrong_slot0: left out: it writes 1 frames from block type 0 row 0 column 30" in x for x in imported.notes
    )


@pytest.mark.parametrize(
    ("fields", "note"),
    [
        ({"accel_type": "XRT_AIE_DFX"}, "not for the PL"),
        ({"pid": "0x34"}, "built for the base with uid 0x34"),
        ({"sharedMemoryConfig": {"size": 1}}, "not carried over: sharedMemoryConfig"),
    ],
)
def test_what_cannot_be_carried_over_is_reported(base: Path, fields: dict[str, Any], note: str) -> None:
    put_accel(base, "odd", 0, 3, **fields)
    assert any(note in text for text in import_dfx_mgr(base).notes)


def test_slot_beyond_those_of_the_shell_is_left_out(base: Path) -> None:
    put_accel(base, "far", 2, 3)
    imported = import_dfx_mgr(base)
    assert "far_slot2" not in imported.configs[1].modules
    assert any("slot 2, but shell.json says 2 slots" in note for note in imported.notes)


def test_folders_without_an_image_and_damaged_images_are_reported(base: Path) -> None:
    folder = put_accel(base, "bad", 0, 3)
    (folder / "bad.bin").write_bytes(b"nothing")
    assert any("bad_slot0: left out" in note and "no sync word" in note for note in import_dfx_mgr(base).notes)


def test_flat_base_is_one_full_configuration(base: Path) -> None:
    put_json(base / "shell.json", {"shell_type": "XRT_FLAT", "num_slots": "1"})
    imported = import_dfx_mgr(base)
    assert [config.name for config in imported.configs] == ["k26_2rp"]
    assert any("XRT" in note for note in imported.notes)


def test_everything_written_loads_and_finds_its_files(base: Path, tmp_path: Path) -> None:
    full, slots = map(load, write(import_dfx_mgr(base), tmp_path))
    assert bitstream_path(full, None) == base / "base.bit.bin"
    assert bitstream_path(slots, "aes_slot1") == base / "aes" / "aes_slot1" / "aes.bin"


def test_link_does_not_replace_a_file(base: Path, tmp_path: Path) -> None:
    put_accel(base, "fir", 1, 9, slot_overlay(1, "fir.bin", device=True))
    (tmp_path / "fir_slot1.dtbo").write_bytes(b"mine")
    with pytest.raises(ImportRefused, match="is in the way"):
        write(import_dfx_mgr(base), tmp_path)


@pytest.mark.parametrize(
    ("text", "reason"),
    [("{", "not JSON"), ("[]", "a JSON object expected"), ('{"shell_type": "AIE"}', "shell_type AIE")],
)
def test_shell_that_is_not_understood_is_refused(base: Path, text: str, reason: str) -> None:
    (base / "shell.json").write_text(text)
    with pytest.raises(ImportRefused, match=reason):
        import_dfx_mgr(base)


def test_wrong_folder_says_which_is_right(base: Path) -> None:
    with pytest.raises(ImportRefused, match="folders below it have one: k26_2rp"):
        import_dfx_mgr(base.parent)
    with pytest.raises(ImportRefused, match="give the folder of its base"):
        import_dfx_mgr(base / "aes" / "aes_slot0")


def test_overlay_says_what_it_does() -> None:
    info = overlay_info(slot_overlay(1, "x.bin", device=True))
    assert info.firmware == ("x.bin",)
    assert not info.external
    assert info.devices == ("config@80000000",)


@given(st.data())
def test_damaged_overlay_is_read_or_refused(data: st.DataObject) -> None:
    whole = bytearray(slot_overlay(0, "x.bin"))
    for _ in range(data.draw(st.integers(1, 4))):
        whole[data.draw(st.integers(0, len(whole) - 1))] = data.draw(st.integers(0, 255))
    with suppress(ImportRefused):
        overlay_info(bytes(whole[: data.draw(st.integers(0, len(whole)))]))


def test_command_prints_schemas_or_writes_them(base: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["import", "dfx-mgr", str(base)]) == 0
    assert "name: k26_2rp_slots" in capsys.readouterr().out
    assert main(["import", "dfx-mgr", str(base), "--out", str(tmp_path / "out"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["configs"] == ["k26_2rp", "k26_2rp_slots"]
    assert len(found["files"]) == 2
    assert found["notes"]


def test_command_refuses_with_a_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["import", "dfx-mgr", str(tmp_path)]) == 1
    assert "no shell.json" in capsys.readouterr().err


def test_an_accelerator_whose_image_is_a_dangling_link_is_not_left_out_silently(base: Path) -> None:
    image = base / "fft/fft_slot0/fft.bin"
    image.unlink()
    image.symlink_to("nowhere.bin")
    imported = import_dfx_mgr(base)
    assert "fft_slot0" not in imported.configs[1].modules
    assert "fft_slot0: no image (.bin or .bit) is in it" in imported.notes
