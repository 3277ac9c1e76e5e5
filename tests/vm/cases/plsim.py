# SPDX-License-Identifier: Apache-2.0
"""A simulated PL of a test's own: the board's is taken away meanwhile, since the names of channels are unique."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from boardfile import write_bitstreams
from capabilities import LOOK
from served import PATIENCE, pl, until

from cm import device
from cm.formats.bitstream import to_dma_words

ROOT = Path("/sys/kernel/config/cm_plsim")
LIVE = ROOT / "board" / "live"  # of the board in configfs, where it comes from there
FIRMWARE = Path("/opt/cm/firmware/qemu-virt")

Attributes = Mapping[str, object]


def overlay(name: str) -> bytes:
    """A compiled overlay of this board."""
    return (FIRMWARE / f"{name}.dtbo").read_bytes()


def remove_overlays() -> None:
    """Remove those that stand on the static one: a manager leaves them in the kernel when it ends."""
    overlays = device.Overlays("/")
    for name in overlays.list():
        if name != "static":
            overlays.remove(name)


@contextlib.contextmanager
def nothing() -> Iterator[None]:
    """Without the board that the tests were started on; it is back afterwards."""
    _take_away()
    try:
        yield
    finally:
        _bring_back()


def _take_away() -> None:
    if LOOK["overlay"]():
        remove_overlays()
    if "static" in device.Overlays("/").list():
        device.Overlays("/").remove("static")
    else:
        LIVE.write_text("0")
    assert (device.list_dma(), device.list_icap()) == ([], [])


def _regions_bound() -> bool:
    """The kernel binds what waited for something else in a thread of its own; a region waits for the port."""
    devices = Path("/sys/bus/platform/devices").iterdir()
    return all((folder / "driver").exists() for folder in devices if "fpga-region" in folder.name)


def _bring_back() -> None:
    if not LIVE.exists():
        device.Overlays("/").apply("static", overlay(os.environ.get("CM_VM_STATIC", "static")))
        until(_regions_bound)
    else:
        LIVE.write_text("1")
    pl("icap", "delay_us").write_text(os.environ["CM_VM_LOAD_US"])


@contextlib.contextmanager
def board(channels: Mapping[str, Attributes], windows: Mapping[str, Attributes]) -> Iterator[Path]:
    """A board described in configfs, alive; gives the debugfs folder of its engine."""
    top = ROOT / "test"
    folders = [top, *(top / "dma" / name for name in channels), *(top / "uio" / name for name in windows)]
    for folder, attributes in zip(folders, [{}, *channels.values(), *windows.values()], strict=True):
        folder.mkdir()
        for name, value in attributes.items():
            (folder / name).write_text(str(value))
    (top / "live").write_text("1")
    try:
        yield Path("/sys/kernel/debug/cm_plsim", (top / "dev_name").read_text().strip())
    finally:
        (top / "live").write_text("0")
        for folder in reversed(folders):
            folder.rmdir()


@contextlib.contextmanager
def loading(folder: Path) -> Iterator[Callable[[], device.IcapCompletion]]:
    """A load of a bitstream through the only port, under way; gives what waits for its end."""
    write_bitstreams(folder)
    words = to_dma_words((folder / "edge.bit").read_bytes())
    with device.Icap.open() as port, port.allocate(len(words)) as buffer:
        buffer.array(0, len(words))[:] = bytearray(words)
        port.load(buffer, len(words))
        yield lambda: port.wait(PATIENCE)
