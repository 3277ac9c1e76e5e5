# SPDX-License-Identifier: Apache-2.0
"""A pytest plugin: assembles the bitstreams of the board's system and tells the device suite what the board has."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

FIRMWARE = Path("/lib/firmware/cm/camera")
MODULES = {"default": 0, "edge": 0, "colorise": 0, "loopback": 1}  # and the index of their region
SIZE = 16 * 1024  # bytes of a bitstream: an emulated processor looks at each word
OVERLAY = FIRMWARE / "leds.dtbo"  # only where the kernel takes overlays
STATIC, EVENTS = 0x58001000, 0x59001000
LENT = (0x58008000, 0x58002000)  # of a device tree; of cm_plsim


def write_bitstreams(folder: Path = FIRMWARE) -> None:
    """Bitstreams of all modules of guest/system/camera.yaml, as .bit files."""
    from cm.formats.bitstream import assemble_module

    folder.mkdir(parents=True, exist_ok=True)
    for name, index in MODULES.items():
        target = folder / f"{name}.bit"
        if not target.exists():
            target.write_bytes(assemble_module(name, region_index=index, size=SIZE))


def _lent() -> int:
    from cm import device

    there = {place.address for info in device.list_uio("/") for place in info.maps}
    return next(address for address in LENT if address in there)


def describe() -> dict[str, object]:
    """The fields of tests/device/suite_board.Board for this board."""
    from cm import device

    return {
        "to_pl": "to_pl",
        "from_pl": "from_pl",
        "uio": device.find_uio(STATIC, 4, "/")[0].node,
        "scratch": 0x14,
        "memory": [0x800, 0x800],
        "irq": device.find_uio(EVENTS, 4, "/")[0].node,
        "trigger": [0x30, 1],
        "lend": [_lent(), 0x14],
        "icap": next(iter(device.list_icap("/")), None),
        "overlay": str(OVERLAY) if OVERLAY.exists() else None,
        "bitstream": str(FIRMWARE / "loopback.bit"),
    }


def pytest_collection_finish(session: pytest.Session) -> None:
    write_bitstreams()
    given = session.config.getoption("--board-file", None)
    if given is not None:
        given.write_text(json.dumps(describe()))
