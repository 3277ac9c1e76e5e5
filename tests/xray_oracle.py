# SPDX-License-Identifier: Apache-2.0
"""Runs Project X-Ray's own programs on bitstreams."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Sequence
from pathlib import Path

import pytest

from cm.design.debian_packages import PackagesUnavailable, PackageTree, fetch
from cm.formats.bitstream import FrameAddress, open_image
from cm.formats.bitstream.geometry import encode_far, geometry_of
from cm.formats.bitstream.idcodes import Family
from cm.formats.bitstream.packets import frame_writes

DATABASE = "usr/share/prjxray/database"
PARTS = {"xc7z020": "zynq7/xc7z020clg400-1", "xc7a50t": "artix7/xc7a50tcsg324-1", "xc7z010": "zynq7/xc7z010clg400-1"}


def fetched_or_skipped(names: Sequence[str] = ("prjxray", "prjxray-database")) -> PackageTree:
    """Packages of Debian's; the test is skipped where they cannot be had."""
    if os.environ.get("CM_OFFLINE"):
        pytest.skip(f"CM_OFFLINE: {names[0]} is not fetched")
    try:
        return fetch(names)
    except (PackagesUnavailable, OSError) as problem:
        pytest.skip(f"{names[0]} cannot be fetched: {problem}")


def run(tree: PackageTree, program: str, *arguments: str) -> None:
    done = subprocess.run(tree.command(program, *arguments), capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def part(tree: PackageTree, device: str) -> Path:
    return tree.path(f"{DATABASE}/{PARTS[device]}/part.yaml")


def read_bits(tree: PackageTree, device: str, data: bytes, folder: Path) -> set[tuple[int, int, int]]:
    """What bitread finds set in a bitstream: (frame address, word, bit)."""
    (folder / "in.bit").write_bytes(data)
    options = ["-part_file", str(part(tree, device)), "-o", str(folder / "out.bits"), "-z", "-y"]
    run(tree, "bitread", *options, str(folder / "in.bit"))
    lines = (folder / "out.bits").read_text().split()
    return {(int(far, 16), int(word), int(bit)) for _, far, word, bit in (line.split("_") for line in lines)}


def frames_read(path: Path, device: str) -> dict[int, bytes]:
    """Frames by address, as our parser and our table of columns take a full bitstream apart."""
    geometry = geometry_of(device)
    assert geometry is not None
    (write,) = frame_writes(open_image(path))
    found, at = {}, 0
    for key in sorted(key for key in geometry.rows if key[0] < 2):
        row = geometry.rows[key]
        for column in range(row.columns):
            for minor in range(row.frames(column)):
                found[encode_far(FrameAddress(*key, column, minor), Family.SERIES7)] = write.data[at : at + 404]
                at += 404
        at += 808  # two frames of padding end a row
    return found
