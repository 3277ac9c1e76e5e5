# SPDX-License-Identifier: Apache-2.0
"""How fast bitstreams are inspected, beside a plain sha256 of the same bytes.

    python tests/bench/bench_bitstream.py [FILE…]

Without files: a plain and a compressed bitstream of about 4 MB from our own assembler. The
measurements alternate, so that what else the machine does hits all alike; what is printed is the
median CPU time of one core, as bytes of the file per second.

- packets: containers, packets, CRC and rules; everything `inspect` does but the hash
- inspect: with the sha256 of the file, as the manager runs it before a load
- sha256: `hashlib.sha256` alone
"""

from __future__ import annotations

import argparse
import hashlib
import statistics
import time
from collections.abc import Callable
from pathlib import Path

from cm.formats.bitstream import FrameAddress, FrameRun, SharedFrame, assemble, inspect, open_image
from cm.formats.bitstream.inspect import analyse

FRAME_BYTES = 404


def plain() -> bytes:
    """One long run of frames, as in a full bitstream without compression."""
    return assemble("xc7z020", [FrameRun(FrameAddress(0, 0, 0), hashlib.shake_128(b"x").digest(10_000 * FRAME_BYTES))])


def compressed() -> bytes:
    """Many single frames and MFWR packets: the most packets that a file of this size can hold."""
    frame = hashlib.shake_128(b"y").digest(FRAME_BYTES)
    columns = [
        tuple(FrameAddress(0, row, column, minor) for minor in range(36)) for row in range(4) for column in range(150)
    ]
    return assemble("xc7z020", [SharedFrame(frame, column) for column in columns])


def seconds(work: Callable[[], object]) -> float:
    """CPU seconds of one run."""
    start = time.process_time()
    work()
    return time.process_time() - start


def measure(data: bytes, rounds: int) -> dict[str, float]:
    """Return MB/s of each kind of work on `data`."""
    works: dict[str, Callable[[], object]] = {
        "packets": lambda: analyse(open_image(data)),
        "inspect": lambda: inspect(data),
        "sha256": lambda: hashlib.sha256(data).digest(),
    }
    times: dict[str, list[float]] = {name: [] for name in works}
    for _ in range(rounds):
        for name, work in works.items():
            times[name].append(seconds(work))
    return {name: len(data) / statistics.median(found) / 1e6 for name, found in times.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="*", type=Path)
    parser.add_argument("--rounds", type=int, default=31)
    args = parser.parse_args()
    sources = {path.name: path.read_bytes() for path in args.files} or {"plain": plain(), "compressed": compressed()}
    print(f"{'file':32} {'bytes':>9} {'packets':>9} {'inspect':>9} {'sha256':>9}  MB/s")
    for name, data in sources.items():
        rates = measure(data, args.rounds)
        print(f"{name:32} {len(data):9} " + " ".join(f"{rates[key]:9.0f}" for key in ("packets", "inspect", "sha256")))


if __name__ == "__main__":
    main()
