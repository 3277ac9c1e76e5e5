# SPDX-License-Identifier: Apache-2.0
"""The options of ``cm sim``, without the imports that running it needs."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TypeVar

_N = TypeVar("_N", int, float)


def _simple(text: str) -> tuple[str, tuple[int, bool]]:
    name, bits, blind = [*text.split(":"), "", ""][:3]
    if blind not in ("", "blind"):
        raise argparse.ArgumentTypeError(f"{blind!r}: what may follow the bits is blind")
    if bits and not (bits.isdecimal() and 8 <= int(bits) <= 26):
        raise argparse.ArgumentTypeError(f"{bits!r} bits: an AXI DMA's length register has 8 to 26 (PG021)")
    return name, (int(bits or 14), bool(blind))


def _from(least: _N, read: Callable[[str], _N], what: str) -> Callable[[str], _N]:
    def value_of(text: str) -> _N:
        with suppress(ValueError):
            value = read(text)
            if least <= value < math.inf:
                return value
        raise argparse.ArgumentTypeError(f"{text!r} is not {what}, {least:g} or more")

    return value_of


_natural = _from(0, int, "a whole number")
_positive = _from(1, int, "a whole number")
_number = _from(0.0, float, "a number")


def _identity(text: str) -> int:
    with suppress(ValueError):
        return int(text, 0)
    raise argparse.ArgumentTypeError(f"{text!r} is not a number such as 0xca4e0002")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of ``cm sim`` and ``python -m cm.simulation.software``."""
    add = parser.add_argument
    add("--root", type=Path, help="folder to serve (default: a fresh one in memory)")
    add("--config", type=Path, action="append", default=[], metavar="PATH",
        help="runtime schema, or folder of them; may be repeated (default: the shipped camera example)")  # fmt: skip
    add("--images", type=Path, metavar="DIR", help="pictures for the camera (default: three photographs)")
    add(
        "--hold",
        type=_natural,
        default=150,
        metavar="FRAMES",
        help="for how many frames each picture stays (150); 0: for ever",
    )
    add(
        "--rate",
        type=_number,
        metavar="FPS",
        help="frames per second of every camera (default: as the schema says); 0: as fast as they are taken",
    )
    add(
        "--icap-rate",
        type=_number,
        metavar="BYTES",
        help="speed of the ICAP in bytes per second (default: the device's); 0: no delay",
    )
    add(
        "--pcap-rate",
        type=_number,
        default=145e6,  # as the kernel's driver reaches
        metavar="BYTES",
        help="speed of the fpga_manager in bytes per second (145e6)",
    )
    add("--memory", type=_positive, default=512, metavar="MIB", help="MiB of DMA memory of the board (512)")
    add("--vdma", action="append", default=[], metavar="CHANNEL",
        help="make this a channel of a VDMA, which moves frames of lines only; may be repeated")  # fmt: skip
    add("--simple-dma", action="append", type=_simple, default=[], metavar="CHANNEL[:BITS[:blind]]",
        help="no scatter/gather, a length register of BITS bits (14); blind: lengths are not reported")  # fmt: skip
    add("--non-coherent", action="store_true",
        help="DMA memory that has to be synchronised (docs/simulator.md)")  # fmt: skip
    add("--static-identity", type=_identity, metavar="VALUE",
        help="identity that the static part reports (default: the one that the configurations expect)")  # fmt: skip
    add("--models", action="append", default=[], metavar="MODULE", help="module or .py file with a mapping MODELS")
    add("--linger", type=_number, metavar="SECONDS",
        help="exit when the parent has died and no client has been connected for this long")  # fmt: skip
    add("--ready-fd", type=_natural, metavar="N", help="file descriptor for the ready line (default: standard output)")
