# SPDX-License-Identifier: Apache-2.0
"""A bit of a region's configuration turns over, the picture goes wrong, and a check with repair brings it back."""

from __future__ import annotations

import random
import shutil
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from cm.client.board import Board, connect
from cm.errors import CmError, Timeout
from cm.formats.bitstream.memory import frames_in
from cm.formats.xray import set_bits
from cm.formats.xray.drawing import columns_of, region_picture, with_names, wrong_words
from cm.formats.xray.fabric import row_of
from cm.simulation.bits.main import collected
from cm.simulation.software.hardware.camera import shipped_photos
from cm.simulation.software.transport.scratch import Scratch, temporary
from cm.tools.demo.sheet import Picture, contact_sheet
from cm.tools.testing.served import Served
from cm.wire.messages.status import FrameError

_MODE, _MODULE = "edge_detection", "edge"
_REPAIRED = {"frames": "the frame was written again", "load": "the region was loaded again"}
_HITS = 12  # at most, until one can be seen
_WAIT = 60.0  # seconds for a picture: the simulator compiles what the bits are now


class NothingSeen(CmError):
    """No hit changed the picture, or a repair did not bring it back."""

    code = "nothing_seen"


def run_scrub_demo(build: Path, out: Path, say: Callable[[str], None] = print) -> Path:
    """Write ``scrub.png``, the picture before, hit and repaired, and ``scrub.svg``, where the hit was.

    `build` is the build schema of the example open_camera, built by the open flow. The simulated board has an ICAP,
    which the example's static part has not: that is loaded by the fpga_manager, and could not be read.
    """
    files = collected(build)
    with Scratch("cm-scrub-", temporary()) as folder:
        schema = _by_icap(files, folder / files.name)
        served = Served("bits", (str(schema),), build=str(build))
        try:
            with connect(str(served.runtime), timeout=_WAIT) as board:
                return _run(board, served, _used(files / f"{_MODULE}.bin"), out, say)
        finally:
            served.stop()


def _by_icap(files: Path, folder: Path) -> Path:
    """The collected configuration, with its region loaded by ICAP; the path of its schema."""
    shutil.copytree(files, folder)
    schema = folder / f"{files.name}.yaml"
    schema.write_text(schema.read_text("utf-8").replace("loader: fpga_manager", "loader: icap"), "utf-8")
    return schema


def _used(bitstream: Path) -> Iterator[tuple[int, int]]:
    """Bits that are set in frames of logic and routing, in a random order that is always the same."""
    _, frames = frames_in(bitstream)
    found = [(far, bit) for far, frame in frames.items() if not far >> 23 for bit in set_bits(frame)]
    kept = [(far, bit) for far, bit in found if row_of(bit // 32) is not None]  # not the clock row and the checksums
    random.Random(1).shuffle(kept)
    yield from kept


def _run(board: Board, served: Served, used: Iterator[tuple[int, int]], out: Path, say: Callable[[str], None]) -> Path:
    config = board.status.configs[0]
    board.load(config, _MODE, progress=False)
    (region,) = (one.name for one in board.status.regions)
    photo = next(iter(shipped_photos().values()))
    before = _through(board, photo)
    if before is None:
        raise NothingSeen("no picture came through the region before anything was hit")
    for number in range(1, _HITS + 1):
        far, bit = next(used)
        served.control.upset(region, frame=far, bit=bit)
        hit = _through(board, photo)
        found = board.check_region(region)
        told = f"hit {number}: bit {bit % 32} of word {bit // 32} in frame {far:08X}"
        seen = "no picture came" if hit is None else f"{np.count_nonzero(hit != before)} pixels wrong"
        say(f"{told}: {seen}; the check found {found.wrong_bits} bit wrong")
        if hit is not None and not np.array_equal(hit, before):
            where = _drawn(board, region, found.wrong, out)
        repaired = board.check_region(region, repair=True)
        after = _through(board, photo)
        if repaired.verdict != "good" or after is None or not np.array_equal(after, before):
            raise NothingSeen(f"{told}: the region was repaired ({repaired.verdict}), and the picture is not as before")
        if hit is not None and not np.array_equal(hit, before):
            rows = {"before": [before], told: [hit], f"repaired: {_REPAIRED[repaired.repaired]}": [after]}
            contact_sheet(rows, out / "scrub.png")
            say(f"where it was: {where}")
            return out / "scrub.png"
    raise NothingSeen(f"none of {_HITS} hits changed the picture")


def _drawn(board: Board, region: str, wrong: Sequence[FrameError], out: Path) -> Path:
    """The region's frames with what is wrong in red."""
    found = board.map_region(region)
    columns = columns_of(found)
    known = with_names(found.device, columns)
    red = wrong_words((one.far, one.bits) for one in wrong)
    picture = region_picture(found, known or columns, red, known is not None)
    out.mkdir(parents=True, exist_ok=True)
    (out / "scrub.svg").write_text(picture, "utf-8")
    return out / "scrub.svg"


def _through(board: Board, photo: Picture) -> Picture | None:
    """What comes back for a picture; None where nothing does."""
    try:
        with board.stream("camera", timeout=_WAIT) as results, board.writer("pictures", timeout=_WAIT) as writer:
            writer.write(photo)
            return np.array(results.read(), np.uint8)
    except Timeout:
        return None
