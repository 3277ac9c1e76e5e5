# SPDX-License-Identifier: Apache-2.0
"""The options of ``cm sim``, without the imports that running it needs."""

from __future__ import annotations

import argparse
from pathlib import Path


def _simple(text: str) -> tuple[str, tuple[int, bool]]:
    name, bits, blind = [*text.split(":"), "", ""][:3]
    if blind not in ("", "blind"):
        raise argparse.ArgumentTypeError(f"{blind!r}: what may follow the bits is blind")
    if bits and not (bits.isdecimal() and 8 <= int(bits) <= 26):
        raise argparse.ArgumentTypeError(f"{bits!r} bits: an AXI DMA's length register has 8 to 26 (PG021)")
    return name, (int(bits or 14), bool(blind))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of ``cm sim`` and ``python -m cm.simulation.software``."""
    add = parser.add_argument
    add("--root", type=Path, help="folder to serve (default: a fresh one in memory)")
    add("--config", type=Path, action="append", default=[], metavar="PATH",
        help="runtime schema, or folder of them; may be repeated (default: the shipped camera example)")  # fmt: skip
    add("--images", type=Path, metavar="DIR", help="pictures for the camera (default: three photographs)")
    add("--hold", type=int, default=150, metavar="FRAMES", help="for how many frames each picture stays; 0: for ever")
    add("--rate", type=float, metavar="FPS", help="frames per second of every camera; 0: as fast as they are taken")
    add(
        "--icap-rate",
        type=float,
        metavar="BYTES",
        help="speed of the ICAP in bytes per second (default: the device's); 0: no delay",
    )
    add(
        "--pcap-rate",
        type=float,
        default=145e6,  # as the kernel's driver reaches
        metavar="BYTES",
        help="speed of the fpga_manager in bytes per second",
    )
    add("--memory", type=int, default=512, metavar="MIB", help="DMA memory of the board")
    add(
        "--bitstream-size", type=int, metavar="BYTES", help="frame data in assembled bitstreams (default: the region's)"
    )
    add("--vdma", action="append", default=[], metavar="CHANNEL",
        help="make this a channel of a VDMA, which moves frames of lines only; may be repeated")  # fmt: skip
    add("--simple-dma", action="append", type=_simple, default=[], metavar="CHANNEL[:BITS[:blind]]",
        help="no scatter/gather, a length register of BITS bits (14); blind: lengths are not reported")  # fmt: skip
    add("--non-coherent", action="store_true",
        help="DMA memory that has to be synchronised (docs/simulator.md)")  # fmt: skip
    add("--static-identity", type=lambda text: int(text, 0), metavar="VALUE",
        help="identity that the static part reports (default: the one that the configurations expect)")  # fmt: skip
    add("--seed", type=int, default=1, help="seed of the noise that unloaded regions produce")
    add("--models", action="append", default=[], metavar="MODULE", help="module or .py file with a mapping MODELS")
    add("--linger", type=float, metavar="SECONDS",
        help="exit when the parent has died and no client has been connected for this long")  # fmt: skip
    add("--ready-fd", type=int, metavar="N", help="file descriptor for the ready line (default: standard output)")
