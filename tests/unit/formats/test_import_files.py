# SPDX-License-Identifier: Apache-2.0
"""Imports beside what is there already, and packages whose files have other names than expected."""

from __future__ import annotations

from pathlib import Path

import pytest
from import_support import bitstream, hwh, module, slot_overlay

from cm.cli.main import main
from cm.formats.bitstream import to_dma_words
from cm.formats.importers import ImportRefused, import_dfx_mgr, import_pynq, write
from cm.schema import load
from cm.schema.model import ConfigType
from cm.schema.named_files import bitstream_path, overlay_path


def design(folder: Path, name: str, described: str | None = None) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / f"{name}.bit").write_bytes(bitstream())
    (folder / f"{described or name}.hwh").write_bytes(hwh(module("ps", "processing_system7")))
    return folder / f"{name}.bit"


def bare(folder: Path, image: bytes, firmware: str) -> Path:
    """A package as fpgautil takes it."""
    folder.mkdir()
    (folder / "pl.bit.bin").write_bytes(to_dma_words(image))
    (folder / "pl.dtbo").write_bytes(slot_overlay(0, firmware, device=True))
    return folder


def test_a_wrappers_bitstream_finds_the_description_of_its_design(tmp_path: Path) -> None:
    assert import_pynq(design(tmp_path, "cam_wrapper", "cam")).configs[0].name == "cam_wrapper"


def test_a_description_of_any_name_can_be_given(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bit = design(tmp_path, "cam", "other")
    assert main(["import", "pynq", str(bit)]) != 0
    assert main(["import", "pynq", str(bit), "--hwh", str(tmp_path / "other.hwh")]) == 0
    assert "name: cam" in capsys.readouterr().out


def test_an_import_again_replaces_its_own_schema(tmp_path: Path) -> None:
    bit = design(tmp_path, "cam")
    (path,) = write(import_pynq(bit), tmp_path / "out")
    before = path.read_text()
    bit.write_bytes(bitstream(count=2))
    write(import_pynq(bit), tmp_path / "out")
    assert path.read_text() != before


def test_a_schema_that_was_edited_is_kept_and_the_difference_shown(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bit, out = design(tmp_path, "cam"), tmp_path / "out"
    (path,) = write(import_pynq(bit), out)
    edited = path.read_text().replace("doc: ", "doc: Mine. ")
    path.write_text(edited)
    assert main(["import", "pynq", str(bit), "--out", str(out)]) != 0
    said = capsys.readouterr().err
    assert "it was written or edited by hand; --force replaces it" in said
    assert "\n-  doc: Mine. From" in said
    assert path.read_text() == edited
    assert main(["import", "pynq", str(bit), "--out", str(out), "--force"]) == 0
    assert "Mine" not in path.read_text()


def test_two_designs_whose_names_become_one_file_are_refused(tmp_path: Path) -> None:
    write(import_pynq(design(tmp_path / "a", "cam.v2")), tmp_path / "out")
    with pytest.raises(ImportRefused, match=r"it is of cam\.v2\.bit, and cam_v2\.bit would have the same name"):
        write(import_pynq(design(tmp_path / "b", "cam_v2")), tmp_path / "out")


def test_an_overlay_that_names_an_image_that_is_not_there_finds_the_packages_own(tmp_path: Path) -> None:
    """Its name stands beside the schema, where the manager looks first, and leads to the folder's image."""
    folder = bare(tmp_path / "net", bitstream(), "somewhere.bit.bin")
    (path,) = write(import_dfx_mgr(folder), tmp_path / "out")
    config = load(path)
    (overlay,) = config.overlays
    assert overlay_path(config, overlay).parent == tmp_path / "out"
    assert (tmp_path / "out/somewhere.bit.bin").resolve() == bitstream_path(config, None) == folder / "pl.bit.bin"


def test_an_overlay_that_names_an_image_in_another_folder_is_refused(tmp_path: Path) -> None:
    folder = bare(tmp_path / "net", bitstream(), "xilinx/net.bit.bin")
    with pytest.raises(ImportRefused, match=r"names the image xilinx/net\.bit\.bin, which is not there"):
        import_dfx_mgr(folder)


@pytest.mark.parametrize(("column", "kind"), [(None, ConfigType.FULL), (3, ConfigType.PARTIAL)])
def test_an_image_with_its_overlay_is_a_package(tmp_path: Path, column: int | None, kind: ConfigType) -> None:
    folder = bare(tmp_path / "net", bitstream(column), "pl.bit.bin")
    (config,) = import_dfx_mgr(folder).configs
    image = config.bitstream if column is None else config.modules["net"].bitstream
    assert (config.type, image) == (kind, folder / "pl.bit.bin")
