# SPDX-License-Identifier: Apache-2.0
"""Pictures through modules that open tools have built: each runs by the bits of its bitstream."""

from __future__ import annotations

import select
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cm.bits.files import collected, streams_of
from cm.bits.regions import LoadedBits
from cm.demo.sheet import Picture, contact_sheet
from cm.errors import CmError
from cm.rtl.compile import NOTHING, compile_engine, compile_units
from cm.rtl.design import RtlDesign, load_rtl_design, wiring
from cm.rtl.messages import Op
from cm.rtl.process import EngineProcess
from cm.rtl.tools import find_tools
from cm.sim.hardware.camera import shipped_photos

_IN, _OUT, _ROOM = 64 << 20, 192 << 20, 1 << 22
_DECOUPLE, _IDENTITY = 0x100, 0x10C  # of the control registers
_TRIES = 1000  # reads until a region is out of its reset


class ShowFailed(CmError):
    """A module did not answer as what was loaded."""

    code = "show_failed"


@dataclass(frozen=True)
class Shown:
    """What came out of a module, and what of it was not simulated."""

    picture: Picture
    left_out: tuple[str, ...]


def run_bits_demo(build: Path, out: Path, say: Callable[[str], None] = print) -> Path:
    """A photograph through each module of the first region of a design built by the open flow, as a contact sheet."""
    photo = next(iter(shipped_photos().values()))
    rows: dict[str, list[Picture]] = {"what goes in": [photo]}
    for name, shown in through_modules(build, photo, say).items():
        remark = " (not all of it is simulated)" if shown.left_out else ""
        rows[f"{name}, by its bits{remark}"] = [shown.picture]
    contact_sheet(rows, out / "bits.png")
    return out / "bits.png"


def through_modules(build: Path, photo: Picture, say: Callable[[str], None] = print) -> dict[str, Shown]:
    """What comes out of each module, by name. CmError where something is not there, or answers as another."""
    with tempfile.TemporaryDirectory(prefix="cm-bits-") as text:
        folder = Path(text)
        design, tools = load_rtl_design(build, folder / "tree"), find_tools()
        loaded = LoadedBits.of(design.system, tools, NOTHING, folder)
        whole, modules = streams_of(collected(build), design.system)
        (static,) = compile_units(tools, [design.static])
        # what leaves the device is looked at here, and not dropped
        (folder / "wiring").write_text(wiring(design, static, 1).replace("\ndrain ", "\nsink "), encoding="utf-8")
        process = EngineProcess(compile_engine(tools), folder / "wiring")
        found = {}
        try:
            for stream in whole:
                loaded.take(memoryview(stream))
            for name, stream in modules.items():
                loaded.take(memoryview(stream))
                notes = loaded.netlist(design.regions[0]).notes
                found[name] = Shown(_shown(design, process, loaded, name, photo, say), notes)
        finally:
            process.close()
    return found


def _shown(
    design: RtlDesign, process: EngineProcess, loaded: LoadedBits, name: str, photo: Picture, say: Callable[[str], None]
) -> Picture:
    region, one = design.system.regions[0], next(i for i in design.system.implementations if i.name == name)
    netlist = loaded.netlist(region.name)
    kinds: dict[str, int] = {}
    for cell in netlist.cells:
        kinds[type(cell).__name__] = kinds.get(type(cell).__name__, 0) + 1
    say(f"{name}: {', '.join(f'{count} {kind}' for kind, count in sorted(kinds.items()))}")
    base = design.system.control.base
    _write(process, base + _DECOUPLE, 1)
    process.ask(Op.LOAD, 0, 1, text=str(loaded.compiled(region.name)))
    _write(process, base + _DECOUPLE, 0)
    for _ in range(_TRIES):
        identity = _read(process, base + _IDENTITY)
        if identity:
            break
    if identity != one.identity:
        raise ShowFailed(f"{name} answers 0x{identity:08x}, and is 0x{one.identity:08x}")
    data = _through(design, process, photo.tobytes())
    return data.reshape(*photo.shape, -1) if len(data) > photo.size else data.reshape(photo.shape)


def _through(design: RtlDesign, process: EngineProcess, data: bytes) -> Picture:
    numbers = {end.sends: number for number, end in enumerate(design.streams)}
    process.arena[_IN : _IN + len(data)] = data
    process.ask(Op.RECEIVE, numbers[False], _OUT, _ROOM)
    process.ask(Op.SEND, numbers[True], _IN, len(data))
    while True:
        for event in process.take():
            if event.op == Op.RECEIVED:
                return np.frombuffer(process.arena[_OUT : _OUT + event.b], np.uint8)
        if not select.select([process], [], [], 120)[0]:
            raise ShowFailed("no picture came out")


def _write(process: EngineProcess, address: int, value: int) -> None:
    process.arena[:4] = value.to_bytes(4, "little")
    process.ask(Op.WRITE, address, 1, 0, 15)


def _read(process: EngineProcess, address: int) -> int:
    process.ask(Op.READ, address, 1, 0)
    return int.from_bytes(process.arena[:4], "little")
