# SPDX-License-Identifier: Apache-2.0
"""Pictures through modules that open tools have built: each is simulated from the bits of its bitstream."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from cm.errors import CmError
from cm.simulation.bits.main import collected, streams_of
from cm.simulation.bits.regions import LoadedBits
from cm.simulation.rtl.compile import NOTHING, compile_units
from cm.simulation.rtl.design import load_rtl_design
from cm.simulation.rtl.headless import HeadlessDesign
from cm.simulation.rtl.tools import find_tools
from cm.simulation.software.hardware.camera import shipped_photos
from cm.simulation.software.transport.scratch import Scratch, temporary
from cm.tools.demo.sheet import Picture, contact_sheet

_ROOM = 1 << 22  # bytes reserved for a picture that comes out


class ShowFailed(CmError):
    """A module that was loaded gives the identity of another."""

    code = "show_failed"


@dataclass(frozen=True)
class Shown:
    """What came out of a module, and which of its parts were not simulated."""

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
    """What comes out of each module, by name. Raises CmError if a module is missing, or is another."""
    with Scratch("cm-bits-", temporary()) as folder:
        design, tools = load_rtl_design(build, folder / "tree"), find_tools()
        loaded = LoadedBits.of(design.system, tools, NOTHING, folder)
        whole, modules = streams_of(collected(build), design.system)
        identities = {one.name: one.identity for one in design.system.implementations}
        (static,) = compile_units(tools, [design.static])
        found = {}
        with HeadlessDesign(tools, design, static, folder, pins=True) as running:
            for stream in whole:
                loaded.take(memoryview(stream))
            for name, stream in modules.items():
                loaded.take(memoryview(stream))
                netlist = loaded.netlist(design.regions[0])
                kinds = Counter(type(cell).__name__ for cell in netlist.cells)
                say(f"{name}: {', '.join(f'{count} {kind}' for kind, count in sorted(kinds.items()))}")
                identity = running.load(loaded.compiled(design.regions[0]))
                if identity != identities[name]:
                    raise ShowFailed(f"{name} answers 0x{identity:08x}, and is 0x{identities[name]:08x}")
                found[name] = Shown(_picture(running.through(photo.tobytes(), _ROOM), photo), netlist.notes)
    return found


def _picture(data: Picture, photo: Picture) -> Picture:
    """As high and wide as what went in, with as many bytes a pixel as came out."""
    return data.reshape(*photo.shape, -1) if len(data) > photo.size else data.reshape(photo.shape)
