#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""The accelerators that the paper's authors published, in the paper's loop: observe, decide, act.

    git clone https://github.com/accl-kaust/zypr
    python3 examples/zypr/authors.py zypr build/authors

Each filter runs as its RTL behind the simulated board; pictures and registers go through the manager, over ZeroMQ. A
picture with many edges is worth its full size, one with few a half or a quarter. The contact sheet shows what came out.
Nothing of theirs is changed or copied, but for chroma: its two stages are not joined in what was published.
"""

from __future__ import annotations

import argparse
import shutil
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parent))
import references

import cm
from cm.errors import CmError
from cm.simulation.software.hardware.camera import shipped_photos
from cm.simulation.software.hardware.models import palettes
from cm.tools.demo.sheet import contact_sheet
from cm.tools.testing.served import Served

HERE = Path(__file__).parent
START, AUTO_RESTART = 1, 0x80  # of ap_ctrl
MANY = 0.05  # share of pixels on an edge from which on a picture is worth its full size

# Stage two of chroma was given zeros, and stage one no picture: the FIFO between them is missing.
_MENDED = {
    ".p_src_mat_data_V_dout(24'd0)": ".p_src_mat_data_V_dout(in_mat_data_V_dout)",
    ".p_src_mat_data_V_empty_n(1'b1)": ".p_src_mat_data_V_empty_n(in_mat_data_V_empty_n)",
    ".p_dst_mat_data_V_full_n(1'b1)": ".p_dst_mat_data_V_full_n(hsv_full_n)",
    ".src_data_V_dout(24'd0)": ".src_data_V_dout(hsv_dout)",
    ".src_data_V_empty_n(1'b1)": ".src_data_V_empty_n(hsv_empty_n)",
    "img_data_V_read = 1'b0": "img_data_V_read = bgr2hsv_U0_p_src_mat_data_V_read",
    "fifo_w24_d2_A in_mat_data_V_U(": """wire hsv_full_n, hsv_empty_n;
wire [23:0] hsv_dout;
fifo_w24_d2_A hsv_U(
    .clk(ap_clk), .reset(ap_rst_n_inv), .if_read_ce(1'b1), .if_write_ce(1'b1),
    .if_din(bgr2hsv_U0_p_dst_mat_data_V_din), .if_full_n(hsv_full_n), .if_write(bgr2hsv_U0_p_dst_mat_data_V_write),
    .if_dout(hsv_dout), .if_empty_n(hsv_empty_n), .if_read(inRange_U0_src_data_V_read)
);

fifo_w24_d2_A in_mat_data_V_U(""",
}


@dataclass(frozen=True)
class Filter:
    """A module, its streams, and its registers and shapes for pictures with many edges and with few."""

    module: str
    into: str
    out: str
    settings: tuple[Mapping[str, int], Mapping[str, int]]
    shapes: tuple[tuple[tuple[int, ...], tuple[int, ...]], ...]  # in, out


FULL, HALF, QUARTER = (480, 640), (240, 320), (120, 160)
FILTERS = (
    Filter(
        "sobel_a", "to_sobel", "from_sobel",
        ({"rows": 480, "cols": 640}, {"rows": 240, "cols": 320}), ((FULL, FULL), (HALF, HALF)),
    ),
    Filter(
        "resize", "to_resize", "from_resize",
        ({"rows_in": 480, "cols_in": 640, "rows_out": 240, "cols_out": 320},
         {"rows_in": 480, "cols_in": 640, "rows_out": 120, "cols_out": 160}), ((FULL, HALF), (FULL, QUARTER)),
    ),
    Filter(
        "chroma_mended", "to_chroma", "from_chroma",
        ({"rows_in": 480, "cols_in": 640}, {"rows_in": 240, "cols_in": 320}), (((*FULL, 3), FULL), ((*HALF, 3), HALF)),
    ),
)  # fmt: skip


def prepare(zypr: Path, folder: Path) -> Mapping[str, Path]:
    """The build schemas in a folder, with what they name beside them. Raises CmError if the sources are not there."""
    rtl = next(
        (found for found in (zypr / "zypr/tests/demo/rtl", zypr / "rtl", zypr) if (found / "sobel").is_dir()), None
    )
    if rtl is None:
        raise CmError(f"{zypr} is no checkout of github.com/accl-kaust/zypr: it has no zypr/tests/demo/rtl")
    folder.mkdir(parents=True, exist_ok=True)
    link = folder / "zypr"
    link.unlink(missing_ok=True)
    link.symlink_to(rtl.resolve())
    shutil.rmtree(folder / "mended", ignore_errors=True)
    shutil.copytree(rtl / "chroma", folder / "mended")
    text = (rtl / "chroma/chroma.v").read_text()
    for wrong, right in _MENDED.items():
        text = text.replace(wrong, right)
    (folder / "mended/chroma.v").write_text(text)
    for name in ("vision", "words"):
        shutil.copyfile(HERE / f"{name}.yaml", folder / f"{name}.yaml")
    return {name: folder / f"{name}.yaml" for name in ("vision", "words")}


def picture_for(one: Filter, grey: references.Picture, shape: tuple[int, ...]) -> NDArray[Any]:
    """A camera's picture as a filter takes it: smaller by leaving out, in false colours for chroma."""
    small = grey[:: grey.shape[0] // shape[0], :: grey.shape[1] // shape[1]]
    if one.module == "chroma_mended":
        return palettes()[2][small][..., ::-1]  # the rainbow, blue first
    return small.astype(np.uint64) if one.module == "sobel_a" else small


def act(board: cm.Board, one: Filter, few: bool, picture: NDArray[Any]) -> references.Picture:
    """Bring the filter into its region, set it, and send a picture through it."""
    board.set_mode(one.module)
    for stream, shape in zip((one.into, one.out), one.shapes[few], strict=True):
        board.configure_stream(stream, shape=shape, force=True)
    board.registers.write(one.settings[few])
    with board.stream(one.out, timeout=120) as back, board.writer(one.into, timeout=120) as out:
        board.registers["ap_ctrl"] = START
        out.write(picture)
        return np.asarray(back.read()).astype(np.uint8)


def expected(one: Filter, few: bool, picture: NDArray[Any]) -> references.Picture:
    """What should have come out."""
    if one.module == "sobel_a":
        return references.sobel(picture.astype(np.uint8))
    if one.module == "resize":
        height, width = one.shapes[few][1]
        return references.resize(picture, (height, width))
    return references.chroma(picture)


def loop(board: cm.Board, say: Any = print) -> Mapping[str, list[references.Picture]]:
    """The pictures of the camera and of each filter, by what was decided. Raises CmError if one is not as expected."""
    photos = list(shipped_photos().values())
    rows: dict[str, list[references.Picture]] = {"camera": photos}
    for one in FILTERS:
        for photo in photos:
            share = float((act(board, FILTERS[0], False, photo.astype(np.uint64)) > 64).mean())  # observe
            few = share < MANY  # decide
            seen = picture_for(one, photo, one.shapes[few][0])
            result = act(board, one, few, seen)  # act
            wrong = int((result != expected(one, few, seen)).sum())
            settings = ", ".join(f"{name} {value}" for name, value in one.settings[few].items())
            say(f"{one.module}: {share:.1%} on edges: {settings}: {wrong} of {result.size} pixels wrong")
            if wrong:
                raise CmError(f"{one.module} gives {wrong} wrong pixels")
            rows.setdefault(f"{one.module}: {settings}", []).append(result)
    return rows


def main() -> int:
    """The exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("zypr", type=Path, help="checkout of github.com/accl-kaust/zypr")
    parser.add_argument("out", type=Path, help="folder for the contact sheet and what is generated")
    args = parser.parse_args()
    try:
        schemas = prepare(args.zypr, args.out)
        print("the filters are compiled, which takes some minutes the first time")
        served = Served("rtl", (), str(schemas["vision"]))
        try:
            with cm.connect(str(served.runtime), timeout=120.0) as board:
                board.load("vision", mode="sobel_a")
                rows = loop(board)
        finally:
            served.stop()
    except CmError as error:
        print(f"authors.py: {error}", file=sys.stderr)
        return 1
    contact_sheet(rows, args.out / "authors.png")
    print(args.out / "authors.png")
    return 0


if __name__ == "__main__":
    sys.exit(main())
