# SPDX-License-Identifier: Apache-2.0
"""Overlays are looked at before the kernel gets them, whatever bytes they are."""

from __future__ import annotations

import contextlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cm import fdt
from cm.daemon.host.overlays import checked_overlay, firmware_names
from cm.manager.errors import BadOverlay

BLOB = fdt.pack(fdt.overlay("/fpga-region", fdt.FdtNode("", {"firmware-name": b"cm/x/a.bin\0", "empty": b""})))


def test_an_overlay_passes_and_its_firmware_is_found() -> None:
    assert checked_overlay("a.dtbo", BLOB) is BLOB
    assert firmware_names("a.dtbo", BLOB) == ["cm/x/a.bin"]


def test_a_tree_that_is_no_overlay_is_refused() -> None:
    with pytest.raises(BadOverlay, match="__overlay__"):
        checked_overlay("base.dtb", fdt.pack(fdt.FdtNode("", {"model": b"board\0"})))


def test_a_blob_that_is_cut_off_anywhere_is_refused() -> None:
    for length in range(len(BLOB)):
        with pytest.raises(BadOverlay, match=r"a\.dtbo"):
            checked_overlay("a.dtbo", BLOB[:length])


@given(at=st.integers(0, len(BLOB) - 1), value=st.integers(0, 255))
def test_damage_is_refused_or_harmless(at: int, value: int) -> None:
    damaged = BLOB[:at] + bytes([value]) + BLOB[at + 1 :]
    with contextlib.suppress(BadOverlay):
        checked_overlay("a.dtbo", damaged)
        firmware_names("a.dtbo", damaged)


@given(st.binary(max_size=200))
def test_any_bytes_are_refused(data: bytes) -> None:
    with pytest.raises(BadOverlay):
        checked_overlay("a.dtbo", data)
