# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest
from bitstream_support import frames, small

from cm import child
from cm.cli.main import main
from cm.formats.bitstream import FrameAddress, FrameRun, assemble, to_dma_words

SCHEMA = """\
config:
  name: camera
  device: {device}
  regions:
    prr0: {{{region}}}
  modules:
    edge: {{region: prr0, bitstream: edge.bit}}
    zoom: {{region: prr0, bitstream: zoom.bit}}
  modes:
    default: {{modules: [edge]}}
"""


def schema(folder: Path, device: str = "xc7z020", region: str = "") -> Path:
    path = folder / "camera.yaml"
    path.write_text(SCHEMA.format(device=device, region=region))
    return path


def module(folder: Path, name: str, column: int = 26) -> Path:
    path = folder / f"{name}.bit"
    path.write_bytes(assemble("xc7z020", [FrameRun(FrameAddress(0, 0, column), frames(1))]))
    return path


def test_inspect_prints_json_with_the_documented_keys(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bitstream", "inspect", "--json", str(module(tmp_path, "edge"))]) == 0
    found = json.loads(capsys.readouterr().out)
    keys = {"device", "idcode", "family", "partial", "sections", "frames", "crc", "footprint"}
    assert keys <= found.keys()
    assert found["footprint"] == [{"block_type": 0, "row": 0, "column": 26, "frames": 1, "last_column": 26}]


def test_inspect_says_what_people_want_to_know(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bitstream", "inspect", str(module(tmp_path, "edge"))]) == 0
    text = capsys.readouterr().out
    assert "xc7z020 (IDCODE 03727093, 7series)" in text
    assert "columns 26 to 26" in text


def test_inspect_of_a_damaged_file_fails(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = bytearray(small())
    data[data.index(bytes.fromhex("30000001")) + 4] ^= 1
    path = tmp_path / "bad.bit"
    path.write_bytes(data)
    assert main(["bitstream", "inspect", str(path)]) == 1
    assert "REFUSED   crc_mismatch" in capsys.readouterr().out


def test_inspect_of_something_else_names_the_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "notes.txt"
    path.write_text("no bitstream")
    assert main(["bitstream", "inspect", str(path)]) == 1
    assert str(path) in capsys.readouterr().err


def test_inspect_goes_on_behind_files_that_cannot_be_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    absent, notes, good = tmp_path / "absent.bit", tmp_path / "notes.txt", module(tmp_path, "edge")
    notes.write_text("no bitstream")
    memory = Path("/proc/self/mem")  # which is opened, and cannot be read at its beginning
    files = [str(path) for path in (absent, notes, memory, good)]
    assert main(["bitstream", "inspect", *files]) == 1
    said = capsys.readouterr()
    assert [line.split(": ")[1] for line in said.err.splitlines()] == files[:3]
    assert said.out.startswith(f"{good}: bit, partial")
    assert main(["bitstream", "inspect", "--json", *files]) == 1
    found = json.loads(capsys.readouterr().out)
    assert [each["path"] for each in found] == files
    assert [each.get("error", {}).get("code") for each in found] == ["io", "no_sync", "io", None]


def test_verify_takes_a_module_that_fits(tmp_path: Path) -> None:
    path = module(tmp_path, "edge")
    footprint = "footprint: [{block_type: 0, row: 0, columns: [26, 27]}]"
    arguments = ["--config", str(schema(tmp_path, region=footprint)), "--region", "prr0"]
    assert main(["bitstream", "verify", str(path), *arguments]) == 0


def test_verify_refuses_frames_of_another_region(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = module(tmp_path, "edge", column=30)
    footprint = "footprint: [{block_type: 0, row: 0, columns: [26, 27]}]"
    arguments = ["--config", str(schema(tmp_path, region=footprint)), "--region", "prr0", "--json"]
    assert main(["bitstream", "verify", str(path), *arguments]) == 1
    assert json.loads(capsys.readouterr().out)["refusals"][0]["code"] == "footprint_outside"


def test_verify_learns_the_footprint_from_another_module(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    module(tmp_path, "edge")
    path = module(tmp_path, "zoom", column=30)
    assert main(["bitstream", "verify", str(path), "--config", str(schema(tmp_path)), "--region", "prr0"]) == 1
    assert "column 30" in capsys.readouterr().out


def test_verify_says_what_it_could_not_compare(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = module(tmp_path, "edge")  # the only one here: nothing tells what its region is
    arguments = ["bitstream", "verify", str(path), "--config", str(schema(tmp_path)), "--region", "prr0"]
    assert main(arguments) == 0
    said = capsys.readouterr().out
    assert "not compared: the footprint of region prr0 is not known" in said
    assert "good" not in said
    assert main([*arguments, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["not_compared"] == ["footprint"]
    module(tmp_path, "zoom")
    assert main(arguments) == 0
    assert capsys.readouterr().out == f"{path}: good\n"


def test_verify_refuses_another_device(tmp_path: Path) -> None:
    path = module(tmp_path, "edge")
    arguments = ["--config", str(schema(tmp_path, device="xc7z010")), "--region", "prr0"]
    assert main(["bitstream", "verify", str(path), *arguments]) == 1


@pytest.mark.parametrize(("name", "hint"), [("nonsense", "known: xc7z007s, "), ("xc7z0200", "did you mean xc7z020?")])
def test_verify_says_of_a_device_that_is_not_known_which_are(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, hint: str
) -> None:
    path = str(module(tmp_path, "edge"))
    assert main(["bitstream", "verify", path, "--device", name]) == 1
    assert f"meant for {name}, whose IDCODE is not known ({hint}" in capsys.readouterr().out
    assert main(["bitstream", "verify", path, "--device", "xc7z010"]) == 1
    assert "not known" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("option", "value", "wanted"),
    [("device", "", "a device"), ("idcode", "xc7z020", "an IDCODE"), ("idcode", "103722093", "an IDCODE")],
)
def test_verify_says_what_a_device_is_named_by(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], option: str, value: str, wanted: str
) -> None:
    with pytest.raises(SystemExit):
        main(["bitstream", "verify", str(module(tmp_path, "edge")), f"--{option}", value])
    assert f"--{option}: {value!r} is not {wanted}" in capsys.readouterr().err


def test_verify_compares_with_a_bitstream_of_the_same_region(tmp_path: Path) -> None:
    first, same, other = (module(tmp_path, name, column) for name, column in (("a", 3), ("b", 3), ("c", 9)))
    assert main(["bitstream", "verify", str(same), "--like", str(first)]) == 0
    assert main(["bitstream", "verify", str(other), "--like", str(first)]) == 1


def test_verify_of_an_unknown_region_lists_the_known(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = module(tmp_path, "edge")
    assert main(["bitstream", "verify", str(path), "--config", str(schema(tmp_path)), "--region", "prr9"]) == 1
    assert "it has prr0" in capsys.readouterr().err


def test_convert_goes_by_the_names_and_back(tmp_path: Path) -> None:
    original, swapped, again = module(tmp_path, "edge"), tmp_path / "edge.bin", tmp_path / "again.bit"
    assert main(["bitstream", "convert", str(original), str(swapped)]) == 0
    assert swapped.read_bytes() == to_dma_words(original)
    assert main(["bitstream", "convert", str(swapped), str(again), "--header", str(original)]) == 0
    assert again.read_bytes() == original.read_bytes()


def test_convert_to_a_name_that_says_nothing_needs_a_form(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bitstream", "convert", str(module(tmp_path, "edge")), str(tmp_path / "out")]) == 1
    assert "--to" in capsys.readouterr().err


def test_convert_into_a_pipe_leaves_nothing_in_it_but_the_bitstream(tmp_path: Path) -> None:
    original = module(tmp_path, "edge")
    command = child.command("cm", "bitstream", "convert", str(original), "/dev/stdout", "--to", "bin")
    done = subprocess.run(command, env=child.environment(), capture_output=True, timeout=60, check=True)
    assert done.stdout == to_dma_words(original)
    assert b"/dev/stdout: bin, " in done.stderr


def test_convert_names_the_folder_that_is_not_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = tmp_path / "nowhere/edge.bin"
    assert main(["bitstream", "convert", str(module(tmp_path, "edge")), str(output)]) == 1
    assert f"{output}: there is no folder {output.parent}" in capsys.readouterr().err


@pytest.mark.parametrize("form", ["bin", "bin-straight"])
def test_convert_in_place_does_not_lose_the_header(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], form: str
) -> None:
    original = module(tmp_path, "edge")
    before = original.read_bytes()
    link = tmp_path / "link.bit"
    link.symlink_to(original)
    for output in (original, link):
        assert main(["bitstream", "convert", str(original), str(output), "--to", form]) == 1
        assert "would lose the header (design cm_assembled" in capsys.readouterr().err
        assert original.read_bytes() == before


def test_verify_takes_an_idcode_for_a_device_that_is_not_known(tmp_path: Path) -> None:
    original = str(module(tmp_path, "edge"))
    assert main(["bitstream", "verify", original, "--idcode", "0x13727093"]) == 0
    assert main(["bitstream", "verify", original, "--idcode", "03722093"]) == 1
