# SPDX-License-Identifier: Apache-2.0
"""Bitstreams and hardware descriptions of any flow become a configuration that loads."""

from __future__ import annotations

import hashlib
import json
import shutil
import tarfile
import zipfile
from pathlib import Path

import pytest
from bitstream_support import frames
from build_support import MINIMAL, copy_examples, generated, project
from import_support import bitstream, described, hwh, memory, module, port, ports, register

from cm import schema
from cm.cli.main import main
from cm.design.collect.collected import Collected
from cm.design.collect.collection import collect, collect_ours, write
from cm.design.errors import BuildError
from cm.design.generate.generation import Design, generate, load_design
from cm.design.runtime.answers import Answers
from cm.formats.bitstream import assemble_module, inspect
from cm.formats.bitstream.assemble import FrameRun, assemble
from cm.formats.bitstream.geometry import FrameAddress
from cm.schema.model import ConfigType, Direction


def partial(name: str, index: int = 0, device: str = "xc7z020") -> bytes:
    return assemble_module(name, device=device, region_index=index, size=4096)


def design(*more: str, device: str = "7z020") -> bytes:
    """A processor with a register window, a DMA, a decoupler and one region."""
    windows = memory(
        ("acc", 0x43C00000, 0x10000),
        ("dma", 0x40400000, 0x10000),
        ("dec", 0x43C10000, 0x1000),
        ("pr_0", 0x43C20000, 0x1000),
    )
    return hwh(
        module("ps", "processing_system7", windows, ports(port("IRQ_F2P", "I", ("acc", "irq"), kind="INTERRUPT"))),
        module("acc", "acc", described(register("CTRL", 0), register("DATA", 16))),
        module("dma", "axi_dma", parameters={"C_INCLUDE_MM2S": "0"}),
        module("dec", "dfx_decoupler", ports(port("rp_x", "I", ("pr_0", "x")))),
        module("pr_0", "rm", region=True),
        *more,
        device=device,
    )


@pytest.fixture
def theirs(tmp_path: Path) -> Path:
    """A folder with the results of a foreign flow."""
    folder = tmp_path / "theirs"
    folder.mkdir()
    (folder / "top.hwh").write_bytes(design())
    (folder / "top.bit").write_bytes(bitstream(None))
    for name in ("pr_0_add", "pr_0_mul"):
        (folder / f"{name}.bit").write_bytes(partial(name))
    return folder


def test_a_foreign_design_becomes_a_partial_configuration(theirs: Path) -> None:
    config = collect([theirs]).config
    assert (config.name, config.type, config.device) == ("top", ConfigType.PARTIAL, "xc7z020")
    assert {name: one.region for name, one in config.modules.items()} == {"pr_0_add": "pr_0", "pr_0_mul": "pr_0"}
    region = config.regions["pr_0"]
    assert region.decoupler is not None
    assert (region.decoupler.base_address, region.decoupler.bit) == (0x43C10000, 0)
    assert [(area.row, area.column_first) for area in region.footprint] == [(0, 0)]
    assert config.registers["acc_ctrl"].address == 0x43C00000
    assert config.registers["acc_data"].address == 0x43C00010
    assert config.interrupts["acc_irq"].base_address == 0x43C00000
    assert config.streams["dma"].direction is Direction.S2MM


def test_the_images_are_as_the_configuration_port_reads_them(theirs: Path) -> None:
    found = collect([theirs])
    data = found.files["pr_0_add.bin"]
    assert bytes.fromhex("665599AA") in data[:64]
    assert found.config.modules["pr_0_add"].sha256 == hashlib.sha256(data).hexdigest()
    assert inspect(data).problems == ()


def test_bitstreams_of_two_regions_are_distinguished(theirs: Path) -> None:
    (theirs / "pr_1_add.bit").write_bytes(partial("pr_1_add", index=1))
    found = collect([theirs])
    assert found.config.modules["pr_1_add"].region != found.config.modules["pr_0_add"].region
    assert any("no register of the PL or GPIO line decouples it" in note for note in found.notes)


def test_a_bitstream_for_another_device_is_refused(theirs: Path) -> None:
    (theirs / "pr_0_odd.bit").write_bytes(partial("pr_0_odd", device="xc7z010"))
    with pytest.raises(BuildError, match=r"pr_0_odd\.bit: built for xc7z010"):
        collect([theirs])


def test_a_file_of_any_name_gives_a_module_with_a_name(theirs: Path) -> None:
    (theirs / "Größe 2.bit").write_bytes(partial("x"))
    assert "grosse_2" in collect([theirs]).config.modules


@pytest.mark.parametrize("other", ["pr 0 add.bit", "again/pr_0_add.bit"])
def test_two_bitstreams_of_one_module_are_refused(theirs: Path, other: str) -> None:
    """Not one of them taken, and the other left out without a word."""
    (theirs / other).parent.mkdir(exist_ok=True)
    (theirs / other).write_bytes(partial("pr_0_add"))
    with pytest.raises(BuildError, match=r"are both module pr_0_add: rename one"):
        collect([theirs, theirs / other])


def test_a_damaged_bitstream_is_refused(theirs: Path) -> None:
    data = bytearray((theirs / "pr_0_add.bit").read_bytes())
    data[1000] ^= 1
    (theirs / "pr_0_add.bit").write_bytes(data)
    with pytest.raises(BuildError, match=r"pr_0_add\.bit: .*CRC"):
        collect([theirs])


def test_regions_that_overlap_are_refused(theirs: Path) -> None:
    """Half of the columns of one are also written by the other: neither one region nor two."""
    for name, columns in (("pr_1_low", range(4)), ("pr_2_high", range(1, 9))):
        runs = [FrameRun(FrameAddress(0, 5, column), frames(2)) for column in columns]
        (theirs / f"{name}.bit").write_bytes(assemble("xc7z020", runs))
    with pytest.raises(BuildError, match="write the same frames"):
        collect([theirs])


def test_an_xsa_gives_description_and_bitstream(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "system.xsa", "w") as archive:
        archive.writestr("top.hwh", design())
        archive.writestr("../top.bit", bitstream(None))
        archive.writestr("readme.txt", "no concern of ours")
    config = collect([tmp_path / "system.xsa"]).config
    assert (config.type, str(config.bitstream)) == (ConfigType.FULL, "top.bin")
    assert not (tmp_path.parent / "top.bit").exists()


def test_of_registers_that_share_an_address_the_first_is_taken_and_names_the_others(theirs: Path) -> None:
    external = f'<BUSINTERFACE NAME="S_AXI">{memory(("core", 0, 0x1000))}</BUSINTERFACE>'
    aliased = described(register("IER", 4), register("DLM", 4), register("LCR", 12))  # as of a 16550 UART
    (theirs / "pr_0_add.hwh").write_bytes(hwh(module("core", "core", aliased), external=external))
    config = collect([theirs]).config
    found = config.modules["pr_0_add"].registers
    assert {name: one.offset for name, one in found.items()} == {"core_ier": 4, "core_lcr": 12}
    assert "Same address: dlm." in found["core_ier"].doc


def test_a_modules_own_description_gives_its_registers(theirs: Path) -> None:
    external = f'<BUSINTERFACE NAME="S_AXI">{memory(("core", 0, 0x1000))}</BUSINTERFACE>'
    text = hwh(module("core", "core", described(register("GAIN", 8))), external=external)
    (theirs / "pr_0_add.hwh").write_bytes(text)
    register_found = collect([theirs]).config.modules["pr_0_add"].registers["core_gain"]
    assert (register_found.address, register_found.region) == (0x43C20008, "pr_0")


def test_folder_and_archive_hold_the_same_and_the_same_bytes_each_time(theirs: Path, tmp_path: Path) -> None:
    found = collect([theirs])
    first = write(found, tmp_path / "a")[1].read_bytes()
    folder, packed = write(found, tmp_path / "b")
    assert packed.read_bytes() == first
    with tarfile.open(packed) as tar:
        names = sorted(tar.getnames())
    assert names == sorted(f"top/{path.name}" for path in folder.iterdir())
    assert schema.check(folder / "top.yaml") == []


def test_the_command_writes_a_configuration_that_loads(
    theirs: Path, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    target = tmp_path / "target"
    assert main(["build", "collect", str(theirs), "-o", str(target), "--name", "adder", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["config"] == "adder"
    assert main(["check", str(target / "adder/adder.yaml")]) == 0


def test_a_signed_configuration_is_taken_where_its_key_is_trusted(theirs: Path, tmp_path: Path) -> None:
    pytest.importorskip("cryptography", reason="cryptography is not installed")
    from import_support import key_pair

    from cm.formats.signing import Policy, judge

    signers, target = tmp_path / "signers", tmp_path / "target"
    key = key_pair(tmp_path, "release", signers)
    options = ["--target", str(target), "--name", "cam", "--sign", str(key), "--bundle-version", "3"]
    assert main(["build", "collect", str(theirs), *options]) == 0
    found = judge(target / "cam", "cam", Policy("require", signers))
    assert (found.signer, found.version) == ("release", 3)
    (tmp_path / "cm.yaml").write_text(f"policy: {{signatures: require, signers: {signers}}}\n")
    archive, out = str(target / "cam.tar.gz"), str(tmp_path / "firmware")
    assert main(["import", "archive", archive, "--out", out, "--settings", str(tmp_path / "cm.yaml")]) == 0


def test_nothing_to_collect_is_reported(tmp_path: Path) -> None:
    with pytest.raises(BuildError, match="neither"):
        collect([tmp_path])


# our own flow ------------------------------------------------------------------------------------


@pytest.fixture
def ours(tmp_path: Path) -> tuple[Design, Path]:
    """The two-region example with bitstreams as its flow would leave them."""
    found, out = generated(copy_examples(tmp_path), "two_regions")
    (out / "bitstreams").mkdir()
    for one in found.system.implementations:
        data = partial(one.name, one.region.index, "xck26")
        (out / f"bitstreams/{one.name}.bit").write_bytes(data)
    return found, out


def run(found: Design, out: Path) -> Collected:
    return collect_ours([out / "bitstreams"], found.system, Answers(), out)


def test_our_flow_gives_the_generated_schema_with_checksums_and_footprints(ours: tuple[Design, Path]) -> None:
    found = run(*ours)
    generated_config = schema.load(ours[1] / "config/two_regions.yaml")
    assert set(found.config.modules) == set(generated_config.modules)
    for name, one in found.config.modules.items():
        assert one.sha256 == hashlib.sha256(found.files[f"{name}.bin"]).hexdigest()
        assert one.identity == generated_config.modules[name].identity
    rows = {name: {area.row for area in region.footprint} for name, region in found.config.regions.items()}
    assert rows == {"filter": {0}, "correction": {1}}


def test_a_project_named_like_a_module_keeps_its_bitstream_of_the_whole_device(tmp_path: Path) -> None:
    path = project(tmp_path, MINIMAL.replace("small", "one"))
    out = tmp_path / "build"
    built = load_design(path)
    generate(built, out)
    listed = [name for step in json.loads((out / "steps.json").read_text())["steps"] for name in step["outputs"]]
    assert len(listed) == len(set(listed))
    assert {"bitstreams/one.bit", "bitstreams/one_full.bit"} <= set(listed)
    (out / "bitstreams").mkdir()
    (out / "bitstreams/one.bit").write_bytes(partial("one", 0, "xc7z020"))
    full = assemble("xc7z020", [FrameRun(FrameAddress(0, 0, 0), bytes(404))], partial=False)
    (out / "bitstreams/one_full.bit").write_bytes(full)
    assert {"one.bin", "one_full.bin"} <= set(run(built, out).files)


def test_two_products_of_one_name_are_refused_before_the_run(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    path = project(tmp_path, MINIMAL.replace("  one:", "  small_full:\n    top: one"))
    for flow in ("vivado", "open"):
        assert main(["build", "check", "--flow", flow, str(path)]) == 1
        said = capsys.readouterr().out
        assert "the bitstream of small_full in prr0 would both be small_full.bit" in said
    assert main(["build", "generate", str(path)]) == 1


def test_overlays_go_with_it(ours: tuple[Design, Path]) -> None:
    files = run(*ours).files
    kinds = {Path(name).suffix for name in files if name.startswith("module_")}
    assert len(kinds) == 1
    assert kinds <= {".dtbo", ".dtso"}  # .dtso where dtc is not installed
    assert any(name.startswith("two_regions_static.dt") for name in files)


def test_a_missing_module_is_named(ours: tuple[Design, Path]) -> None:
    (ours[1] / "bitstreams/gain.bit").unlink()
    with pytest.raises(BuildError, match="no bitstream for gain"):
        run(*ours)


def test_a_module_built_for_the_other_region_is_refused(ours: tuple[Design, Path]) -> None:
    (ours[1] / "bitstreams/gain.bit").write_bytes(partial("gain", 0, "xck26"))
    with pytest.raises(BuildError, match="write different columns"):
        run(*ours)


def test_a_full_bitstream_for_a_module_is_refused(ours: tuple[Design, Path]) -> None:
    whole = assemble("xck26", [FrameRun(FrameAddress(0, 0, 0), bytes(372))], partial=False)
    (ours[1] / "bitstreams/gain.bit").write_bytes(whole)
    with pytest.raises(BuildError, match=r"gain\.bit is a full bitstream"):
        run(*ours)


def test_a_partial_bitstream_for_the_whole_device_is_refused(ours: tuple[Design, Path]) -> None:
    (ours[1] / "bitstreams/two_regions_full.bit").write_bytes(partial("gain", 1, "xck26"))
    with pytest.raises(BuildError, match=r"two_regions_full\.bit is a partial bitstream; it has to configure"):
        run(*ours)


def test_one_bitstream_under_two_names_is_refused(ours: tuple[Design, Path]) -> None:
    """Each module's contains its identity, which the manager reads after a load."""
    shutil.copy(ours[1] / "bitstreams/invert.bit", ours[1] / "bitstreams/gain.bit")
    with pytest.raises(BuildError, match=r"gain\.bit and invert\.bit are the same bitstream|invert\.bit and gain\.bit"):
        run(*ours)


def test_a_description_from_another_build_is_refused(ours: tuple[Design, Path]) -> None:
    ps = module("ps", "zynq_ultra_ps_e", memory(("dma_icap", 0xA0770000, 0x10000)))
    text = hwh(ps, module("dma_icap", "axi_dma"), device="xck26")
    (ours[1] / "bitstreams/two_regions.hwh").write_bytes(text)
    with pytest.raises(BuildError, match="dma_icap is at 0xa0770000, planned at 0xa4000000"):
        run(*ours)
