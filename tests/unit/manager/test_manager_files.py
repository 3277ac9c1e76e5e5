# SPDX-License-Identifier: Apache-2.0
"""What is loaded is what was validated, whatever happens to the files meanwhile; and their footprints."""

from __future__ import annotations

import errno
import hashlib
import os
import re
import threading
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from manager_schemas import DUO, MANAGED, TEXTS, written
from manager_support import Rig, rig

from cm.formats import fdt
from cm.formats.bitstream import Container, assemble_module, convert
from cm.formats.bitstream.errors import BadContainer, FootprintOutside, Sha256Mismatch, UnknownDevice
from cm.manager.errors import BadOverlay
from cm.manager.inputs import Image
from cm.schema import loads
from cm.schema.model import Config, LoaderKind, Overlay
from cm.server.bitstream_and_overlay_files import MAX_BYTES, BoardFiles
from cm.server.private_folders import UnsafeFolder
from cm.simulation.software import Board as SimBoard
from cm.simulation.software.hardware.board_spec import BoardSpec

DEVICE = "xc7z020"


# ---- footprints -----------------------------------------------------------------------


def module(name: str, region: int) -> bytes:
    """A module's bitstream; each region has its own row."""
    return assemble_module(name, device=DEVICE, region_index=region)


@pytest.fixture
def duo(tmp_path: Path) -> Config:
    folder = tmp_path / "duo"
    folder.mkdir()
    (tmp_path / "state").mkdir()
    for name in ("a0", "a1", "b0", "b1"):
        (folder / f"{name}.bit").write_bytes(module(name, int(name[1])))
    (folder / "schema.yaml").write_text(DUO, encoding="utf-8")
    return loads(DUO, source=folder / "schema.yaml")


def opened(tmp_path: Path) -> BoardFiles:
    return BoardFiles(tmp_path / "root")


def image(files: BoardFiles, config: Config, name: str) -> Image:
    return files.image(config, config.modules[name])


def put(config: Config, name: str, data: bytes) -> None:
    assert config.source is not None
    (config.source.parent / f"{name}.bit").write_bytes(data)


def test_a_region_without_a_footprint_has_that_of_its_first_good_module(duo: Config, tmp_path: Path) -> None:
    put(duo, "b0", module("b0", 1))  # made for the other region
    with pytest.raises(FootprintOutside):
        image(opened(tmp_path), duo, "b0")
    files = opened(tmp_path)
    image(files, duo, "a0")
    put(duo, "a0", b"no bitstream")
    assert image(files, duo, "b0")
    put(duo, "a0", module("a0", 0))
    with pytest.raises(FootprintOutside):
        image(files, duo, "b0")


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"encrypted": True}, "is encrypted"),
        ({"encrypted": True, "idcode": None}, "is encrypted"),
        ({"idcode": None}, "is for a device that is not known"),
        ({"idcode": 0x0123_4093}, "is for a device that is not known"),
    ],
)
def test_frames_that_cannot_be_compared_are_refused_with_the_reason(
    duo: Config, tmp_path: Path, change: dict[str, Any], why: str
) -> None:
    files = opened(tmp_path)
    found = image(files, duo, "a0")
    assert files.loaded_frames(found) is files.loaded_frames(found)
    with pytest.raises(UnknownDevice, match=f"a0.bit {why}: its frames cannot be compared"):
        files.loaded_frames(replace(found, sha256="0" * 64, **change))


# ---- firmware ---------------------------------------------------------------------------


@pytest.fixture
def firmware(tmp_path: Path) -> Path:
    return tmp_path / "root" / "lib" / "firmware"


def copy_of(files: BoardFiles, config: Config, name: str, firmware: Path) -> Path:
    return firmware / files.firmware_name(image(files, config, name))


def test_a_copy_that_a_loss_of_power_has_torn_is_made_again(duo: Config, tmp_path: Path, firmware: Path) -> None:
    files = opened(tmp_path)
    copy = copy_of(files, duo, "a0", firmware)
    good = copy.read_bytes()
    for torn in (b"", good[:100], bytes(len(good)), good[:-4]):
        copy.write_bytes(torn)
        assert copy_of(opened(tmp_path), duo, "a0", firmware) == copy
        assert copy.read_bytes() == good


def test_a_link_in_place_of_a_copy_is_replaced_and_not_followed(duo: Config, tmp_path: Path, firmware: Path) -> None:
    copy = copy_of(opened(tmp_path), duo, "a0", firmware)
    victim = tmp_path / "victim"
    victim.write_bytes(copy.read_bytes())
    copy.unlink()
    copy.symlink_to(victim)
    before = victim.stat()
    assert copy_of(opened(tmp_path), duo, "a0", firmware) == copy
    assert not copy.is_symlink()
    assert victim.stat() == before


def test_copies_are_not_written_through_a_folder_that_is_a_link(duo: Config, tmp_path: Path, firmware: Path) -> None:
    firmware.mkdir(parents=True)
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (firmware / "cm-converted").symlink_to(elsewhere)
    with pytest.raises(UnsafeFolder, match="a link to one"):
        copy_of(opened(tmp_path), duo, "a0", firmware)
    assert list(elsewhere.iterdir()) == []


def test_copies_are_not_put_in_a_world_writable_folder(duo: Config, tmp_path: Path, firmware: Path) -> None:
    folder = firmware / "cm-converted"
    folder.mkdir(parents=True)
    folder.chmod(0o777)
    with pytest.raises(UnsafeFolder, match="can be written by everybody"):
        copy_of(opened(tmp_path), duo, "a0", firmware)
    assert list(folder.iterdir()) == []


def test_a_copy_that_does_not_fit_on_the_disk_leaves_nothing(
    duo: Config, tmp_path: Path, firmware: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        with pytest.raises(OSError, match="No space left"):
            copy_of(opened(tmp_path), duo, "a0", firmware)
    assert list((firmware / "cm-converted").iterdir()) == []
    assert copy_of(opened(tmp_path), duo, "a0", firmware).exists()


def test_only_our_oldest_copies_are_removed_whatever_the_clock_says(
    duo: Config, tmp_path: Path, firmware: Path
) -> None:
    folder = firmware / "cm-converted"
    folder.mkdir(parents=True)
    (folder / "users.bin").write_bytes(b"not ours")
    future = 4_000_000_000  # a board whose clock was right before, and now starts in 1970
    for number in range(80):
        path = folder / f"{99 - number:064x}.bin"  # the newest has the first name
        path.write_bytes(b"")
        os.utime(path, (future + number, future + number))
    (folder / ".killed.new").write_bytes(b"half")
    first = copy_of(opened(tmp_path), duo, "a0", firmware)
    second = copy_of(opened(tmp_path), duo, "a1", firmware)
    assert first.exists()
    left = {path.name for path in folder.iterdir()}
    assert len(left) == 65
    assert {first.name, second.name, "users.bin", f"{99 - 79:064x}.bin"} <= left
    assert f"{99 - 17:064x}.bin" not in left


@pytest.mark.parametrize("shadow", ["updates", os.uname().release, f"updates/{os.uname().release}"])
def test_a_file_that_the_kernel_would_find_first_is_what_is_compared(
    duo: Config, tmp_path: Path, firmware: Path, shadow: str
) -> None:
    files = opened(tmp_path)
    name = files.firmware_name(image(files, duo, "a0"))
    folder = firmware / shadow
    (folder / name).parent.mkdir(parents=True)
    (folder / name).write_bytes(module("b0", 0))
    with pytest.raises(Sha256Mismatch, match="not the bitstream that was checked"):
        files.firmware_name(image(files, duo, "a0"))
    (folder / name).write_bytes((firmware / name).read_bytes())
    assert files.firmware_name(image(files, duo, "a0")) == name


def tell_kernel(root: Path, folder: str) -> Path:
    """Make `folder` the first in which the kernel of the board below `root` looks."""
    parameter = root / "sys/module/firmware_class/parameters/path"
    parameter.parent.mkdir(parents=True)
    parameter.write_text(f"{folder}\n", encoding="ascii")
    place = root / folder.lstrip("/")
    place.mkdir(parents=True)
    return place


def test_copies_go_to_the_folder_that_the_kernel_was_given(duo: Config, tmp_path: Path, firmware: Path) -> None:
    place = tell_kernel(tmp_path / "root", "/run/cm/firmware")
    files = opened(tmp_path)
    name = files.firmware_name(image(files, duo, "a0"))
    assert (place / name).is_file()
    assert not (firmware / name).exists()


def test_no_copy_goes_to_a_folder_that_was_told_to_the_kernel_by_echo(
    duo: Config, tmp_path: Path, firmware: Path
) -> None:
    place = tell_kernel(tmp_path / "root", "/run/cm/firmware")
    parameter = tmp_path / "root/sys/module/firmware_class/parameters/path"
    parameter.write_text("/run/cm/firmware\n\n", encoding="ascii")  # the value's own newline, and that of sysfs
    name = opened(tmp_path).firmware_name(image(opened(tmp_path), duo, "a0"))
    assert (firmware / name).is_file()
    assert not (place / name).exists()


def test_a_file_of_that_name_in_the_kernels_first_folder_is_what_is_compared(
    duo: Config, tmp_path: Path, firmware: Path
) -> None:
    files = opened(tmp_path)
    checked = image(files, duo, "a0")
    name = files.firmware_name(checked)
    place = tell_kernel(tmp_path / "root", "/srv/fw")
    (place / name).parent.mkdir(parents=True)
    (place / name).write_bytes(module("b0", 0))
    with pytest.raises(Sha256Mismatch, match="not the bitstream that was checked"):
        files.check_firmware(name, checked)


# ---- a region that is loaded by overlay -----------------------------------------------------


def overlays_of(config: Config, loading: str, beside: str) -> None:
    """Overlays as dtc makes them: what loads a0 into a region, and one of the mode."""
    assert config.source is not None
    loads = {"firmware-name": b"a0.bit\0", "partial-fpga-config": b""}
    for name, target, properties in (("a0", loading, loads), ("duo_extra", beside, dict[str, bytes]())):
        tree = fdt.overlay(target, fdt.FdtNode("", properties))
        (config.source.parent / f"{name}.dtbo").write_bytes(fdt.pack(tree))


def test_an_overlay_on_a_region_that_another_loads_is_refused_before_it_is_applied(duo: Config, tmp_path: Path) -> None:
    regions = {name: replace(region, loader=LoaderKind.OVERLAY) for name, region in duo.regions.items()}
    by_overlay = replace(duo, regions=regions)
    overlays_of(duo, "/fpga-region-0", "/fpga-region-0")
    with pytest.raises(BadOverlay, match=r"/fpga-region-0, to which a0\.dtbo loads a0 by overlay; .* into a0\.dtbo"):
        opened(tmp_path).overlay(by_overlay, Overlay("duo_extra"), [])
    assert opened(tmp_path).overlay(duo, Overlay("duo_extra"), [])  # its regions are loaded by the ICAP
    overlays_of(duo, "/fpga-region-0", "/fpga-region-1")
    assert opened(tmp_path).overlay(by_overlay, Overlay("duo_extra"), [])


def test_an_overlay_whose_firmware_name_is_only_a_suffix_is_refused(duo: Config, tmp_path: Path) -> None:
    """As in koheron-sdk's issue 523."""
    assert duo.source is not None
    tree = fdt.overlay("/fpga-full", fdt.FdtNode("", {"firmware-name": b".bin\0"}))
    (duo.source.parent / "pl.dtbo").write_bytes(fdt.pack(tree))
    with pytest.raises(BadOverlay, match=r"\.bin"):
        opened(tmp_path).overlay(duo, Overlay("pl"), [])


def test_a_plan_says_whose_interrupt_an_overlay_would_ask_for(duo: Config, tmp_path: Path) -> None:
    def cells(*numbers: int) -> bytes:
        return b"".join(number.to_bytes(4, "big") for number in numbers)

    root = tmp_path / "root"
    live = {"compatible": b"acme,board\0xlnx,zynq-7000\0", "intc/phandle": cells(1)}
    live |= {"intc/#interrupt-cells": cells(3), "fabric@40000000/compatible": b"generic-uio\0"}
    wants = {"interrupt-parent": cells(1), "interrupts": cells(0, 29, 4)}
    live |= {f"fabric@40000000/{name}": value for name, value in wants.items()}
    for name, value in live.items():
        place = root / "proc/device-tree" / name
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(value)
    node = fdt.FdtNode("control@40010000", {"compatible": b"fpga-cm,uio\0", **wants})
    ours = fdt.pack(fdt.overlay("/", fdt.FdtNode("", {}, [node])))
    said = opened(tmp_path).clashes({"base": ours}, [])
    assert list(said) == ["base"]
    assert "/control@40010000 asks for what /fabric@40000000 (generic-uio) has" in said["base"]
    # an overlay that is applied and goes first frees what it has
    applied = root / "sys/kernel/config/device-tree/overlays/old"
    applied.mkdir(parents=True)
    gone = fdt.FdtNode("fabric@40000000", {"compatible": b"generic-uio\0"})
    (applied / "dtbo").write_bytes(fdt.pack(fdt.overlay("/", fdt.FdtNode("", {}, [gone]))))
    assert opened(tmp_path).clashes({"base": ours}, ["old"]) == {}
    assert opened(tmp_path).clashes({"base": ours}, ["not_to_be_read"]) == {}


# ---- sizes ------------------------------------------------------------------------------


def test_a_huge_file_is_refused_before_it_is_read(duo: Config, tmp_path: Path) -> None:
    assert duo.source is not None
    with (duo.source.parent / "a0.bit").open("r+b") as file:
        file.truncate(MAX_BYTES + 1)  # sparse
    with pytest.raises(BadContainer, match="at most 512 MiB"):
        image(opened(tmp_path), duo, "a0")
    with (duo.source.parent / "duo_base.dtbo").open("wb") as file:
        file.truncate(17 << 20)
    with pytest.raises(BadOverlay, match="at most 16 MiB"):
        opened(tmp_path).overlay(duo, Overlay("duo_base"), [])


# ---- replaced while a change runs ---------------------------------------------------------


def replaced(made: Rig, sim: SimBoard, config: str, victim: str, at: str) -> object:
    """Go from default to both, replacing a firmware file at the first operation `at`; return the error."""
    place = sim.root / "lib/firmware/cm" / config / victim
    good, other = place.read_bytes(), module("someone_else", 0)
    if victim.endswith(".bin"):
        other = convert(other, Container.BIN_SWAPPED)
    assert made.go("default", config=config) is None

    def watch(name: str) -> None:
        if name == at and place.read_bytes() == good:
            place.write_bytes(other)

    made.arm(-1)
    made.fault.watch = watch
    error = made.go("both", config=config)
    made.fault.watch = lambda _: None
    assert place.read_bytes() == other
    place.write_bytes(good)
    assert_same(made, sim)
    assert made.go("both", config=config) is None
    return error


def assert_same(made: Rig, sim: SimBoard) -> None:
    """Check that board and status name the same modules, and that all regions are intact."""
    status, state = made.manager.status(), sim.control.state()["regions"]
    assert [state[r.name]["module"] for r in status.regions] == [r.module for r in status.regions]
    assert {r.state for r in status.regions} == {"ready"}


def test_a_file_that_is_replaced_before_the_port_has_it_is_noticed_and_undone(sim: SimBoard, tmp_path: Path) -> None:
    with rig(sim.root, tmp_path / "state", written(tmp_path)["duo"]) as made:
        error = replaced(made, sim, "duo", "b0.bit", "uio.write")
    assert error is not None
    assert error.code == "sha256_mismatch"  # type: ignore[attr-defined]


@pytest.mark.parametrize("at", ["uio.write", "overlays.apply"])
def test_a_file_that_is_replaced_after_the_check_is_not_what_an_overlay_loads(
    sim: SimBoard, tmp_path: Path, at: str
) -> None:
    with rig(sim.root, tmp_path / "state", written(tmp_path)["kernel"]) as made:
        assert replaced(made, sim, "kernel", "l0.bin", at) is None


def test_a_file_that_the_kernel_could_take_as_it_is_is_copied_all_the_same(
    sim: SimBoard, configs: dict[str, Config], tmp_path: Path
) -> None:
    """Otherwise the kernel would open, after the check, a file that others may write to."""
    text = MANAGED.replace("l0: {region: prr0,", "l0: {region: prr0, bitstream: direct.bin,")
    (tmp_path / "managed.yaml").write_text(text, encoding="utf-8")
    config = loads(text, source=tmp_path / "managed.yaml")
    direct = sim.root / "lib/firmware/cm/managed/direct.bin"
    direct.write_bytes(convert(filling("l0", configs), Container.BIN_SWAPPED))
    with rig(sim.root, tmp_path / "state", config) as made:
        assert replaced(made, sim, "managed", "direct.bin", "fpga_manager.load") is None
    copy = sim.root / "lib/firmware" / BoardFiles(sim.root).firmware_name(image(BoardFiles(sim.root), config, "l0"))
    assert copy.parent.name == "cm-converted"
    assert copy.stem == hashlib.sha256(direct.read_bytes()).hexdigest()
    assert copy.read_bytes() == direct.read_bytes()


def filling(name: str, configs: dict[str, Config]) -> bytes:
    """A module's bitstream that fills the board's first region."""
    footprint = BoardSpec.from_configs(configs.values()).regions["prr0"].footprint
    columns = sum(frames.column_last - frames.column_first + 1 for frames in footprint)
    return assemble_module(name, device=DEVICE, footprint=footprint, size=columns * (16 << 10))


class Replacer(threading.Thread):
    """Keeps replacing a file's contents until it is stopped, by renaming and in place."""

    def __init__(self, place: Path, contents: Sequence[bytes]) -> None:
        super().__init__(daemon=True)
        self.place, self.contents = place, contents
        self.stopped = threading.Event()
        self.times = 0

    def run(self) -> None:
        new = self.place.with_name(".new")
        while not self.stopped.wait(0.001):
            content = self.contents[self.times % len(self.contents)]
            if self.times % 3:
                new.write_bytes(content)
                new.replace(self.place)
            else:
                self.place.write_bytes(content)
            self.times += 1


@pytest.mark.parametrize(
    ("config", "victim", "changes"), [("duo", "b0.bit", 120), ("managed", "l0.bin", 120), ("kernel", "l0.bin", 60)]
)
def test_what_is_loaded_is_what_was_hashed_even_if_the_file_is_replaced_meanwhile(
    sim: SimBoard, configs: dict[str, Config], tmp_path: Path, config: str, victim: str, changes: int
) -> None:
    """Two images alternate under the name; whichever is loaded, the record has its hash."""
    text = re.sub(r"(, )?identity: (0x..|\{[^}]*\})", "", TEXTS[config])
    if config == "managed":
        text = text.replace("l0: {region: prr0", f"l0: {{region: prr0, bitstream: {victim}")
    (tmp_path / "schema.yaml").write_text(text, encoding="utf-8")
    schema = loads(text, source=tmp_path / "schema.yaml")
    place = sim.root / "lib/firmware/cm" / config / victim
    modules = (victim[:2], schema.modes["default"].modules[0])
    contents = [filling(name, configs) for name in modules]
    if victim.endswith(".bin"):
        contents = [convert(each, Container.BIN_SWAPPED) for each in contents]
    names = {hashlib.sha256(data).hexdigest(): name for data, name in zip(contents, modules, strict=True)}
    place.write_bytes(contents[0])
    replacer = Replacer(place, contents)
    loaded: Counter[str] = Counter()
    with rig(sim.root, tmp_path / "state", schema, prefetch=64 << 20) as made:
        assert made.go("default", config=config) is None
        replacer.start()
        for _ in range(changes):
            error = made.go("other", config=config)
            assert error is None or error.code in _REFUSALS, error
            held = made.manager.state.region("prr0")
            there = sim.control.state()["regions"]["prr0"]
            assert (there["module"], there["decoupled"]) == (names.get(held.sha256 or "", held.module), False)
            loaded[there["module"] if error is None else "refused"] += 1
            assert made.go("default", config=config) is None
        replacer.stopped.set()
        replacer.join()
    place.write_bytes(contents[0])
    assert modules[0] in loaded, loaded


_REFUSALS = (  # for half a file, or one other than was validated
    "sha256_mismatch", "bad_overlay", "bitstream_container", "bitstream_truncated", "crc_mismatch", "no_sync",
    "bitstream_packet", "frames_incomplete", "crc_missing", "not_partial",
)  # fmt: skip
