# SPDX-License-Identifier: Apache-2.0
"""Overlays are checked before the kernel gets them, whatever their bytes."""

from __future__ import annotations

import contextlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cm.formats import fdt
from cm.manager.errors import BadOverlay
from cm.server.bitstream_and_overlay_files import FirmwareLoad, checked_overlay, firmware_loads, loading_nothing, naming

BLOB = fdt.pack(fdt.overlay("/fpga-region", fdt.FdtNode("", {"firmware-name": b"cm/x/a.bin\0", "empty": b""})))


def test_an_overlay_passes_and_its_firmware_is_found() -> None:
    assert checked_overlay("a.dtbo", BLOB) is BLOB
    assert firmware_loads("a.dtbo", BLOB) == (FirmwareLoad("cm/x/a.bin", partial=False, encrypted=False),)
    for partial, encrypted in ((True, False), (False, True)):
        flags = {"partial-fpga-config": b""} if partial else {"encrypted-fpga-config": b""}
        node = fdt.FdtNode("", {"firmware-name": b"a.bin\0"} | flags)
        found = firmware_loads("a.dtbo", fdt.pack(fdt.overlay("/", node)))
        assert found == (FirmwareLoad("a.bin", partial, encrypted),)


def test_a_copy_names_another_file_or_none_and_is_the_same_otherwise() -> None:
    named = fdt.unpack(naming("a.dtbo", BLOB, "cm-converted/00.bin"))
    assert named == fdt.overlay(
        "/fpga-region", fdt.FdtNode("", {"firmware-name": b"cm-converted/00.bin\0", "empty": b""})
    )
    quiet = fdt.unpack(loading_nothing("a.dtbo", BLOB))
    assert quiet == fdt.overlay("/fpga-region", fdt.FdtNode("", {"empty": b""}))


@pytest.mark.parametrize(
    ("properties", "reason"),
    [
        ({"firmware-name": b"a.bin\0", "external-fpga-config": b""}, "contradict each other; the kernel refuses"),
        ({"firmware-name": b"a.bin\0b.bin\0"}, r"its firmware-name b'a\.bin\\x00b\.bin\\x00' is not one name"),
        ({"firmware-name": b"a.bin"}, "not one name"),
        ({"firmware-name": b"\0"}, "not one name"),
        (
            {"firmware-name": b"a.bin\0", "userkey-encrypted-fpga-config": b""},
            "userkey-encrypted-fpga-config asks for a way",
        ),
        ({"firmware-name": b"a.bin\0", "encrypted-key-name": b"00\0"}, "encrypted-key-name asks for a way of loading"),
        ({"fpga-config-from-dmabuf": b""}, "fpga-config-from-dmabuf would load what cannot be checked first"),
    ],
)
def test_what_cannot_be_known_beforehand_is_refused(properties: dict[str, bytes], reason: str) -> None:
    with pytest.raises(BadOverlay, match=rf"^a\.dtbo: .*{reason}"):
        firmware_loads("a.dtbo", fdt.pack(fdt.overlay("/fpga-region", fdt.FdtNode("", properties))))


def test_firmware_in_a_region_that_the_overlay_adds_is_refused_and_that_of_another_driver_is_its_own() -> None:
    def blob(compatible: bytes) -> bytes:
        node = fdt.FdtNode("node", {"compatible": compatible, "firmware-name": b"r5.elf\0"})
        return fdt.pack(fdt.overlay("/", fdt.FdtNode("", {}, [node])))

    for compatible in (b"fpga-region\0", b"xlnx,region\0fpga-region\0"):
        with pytest.raises(BadOverlay) as refused:
            firmware_loads("a.dtbo", blob(compatible))
        assert str(refused.value) == (
            "a.dtbo: node node adds an fpga-region with firmware-name, which the kernel refuses: "
            "a region is loaded once it exists, by an overlay that targets it"
        )
    assert firmware_loads("a.dtbo", blob(b"fpga-region-2\0")) == ()
    assert firmware_loads("a.dtbo", blob(b"xlnx,zynqmp-r5f\0")) == ()


def test_a_tree_that_is_not_an_overlay_is_refused() -> None:
    with pytest.raises(BadOverlay, match=r"base\.dtb: no fragment has an __overlay__ node; compile an overlay"):
        checked_overlay("base.dtb", fdt.pack(fdt.FdtNode("", {"model": b"board\0"})))


def test_a_blob_that_is_cut_off_anywhere_is_refused() -> None:
    for length in range(len(BLOB)):
        for reads in (checked_overlay, firmware_loads, loading_nothing):
            with pytest.raises(
                BadOverlay, match=r"^a\.dtbo: not a whole device-tree blob \(.*\); compile it with dtc$"
            ):
                reads("a.dtbo", BLOB[:length])


@given(at=st.integers(0, len(BLOB) - 1), value=st.integers(0, 255))
def test_damage_is_refused_or_harmless(at: int, value: int) -> None:
    damaged = BLOB[:at] + bytes([value]) + BLOB[at + 1 :]
    with contextlib.suppress(BadOverlay):
        checked_overlay("a.dtbo", damaged)
        firmware_loads("a.dtbo", damaged)


@given(st.binary(max_size=200))
def test_any_bytes_are_refused(data: bytes) -> None:
    with pytest.raises(BadOverlay):
        checked_overlay("a.dtbo", data)
