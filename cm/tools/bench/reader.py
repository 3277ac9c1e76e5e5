# SPDX-License-Identifier: Apache-2.0
"""A reader of the camera, a process of its own: ``python -m cm.tools.bench.reader FOLDER SECONDS``.

It says that it is ready, waits for a line, reads for that many seconds, and prints frames per second and losses.
"""

from __future__ import annotations

import sys
import time

from cm.client.board import Board


def main(folder: str, seconds: float) -> None:
    """Read."""
    with Board(runtime_dir=folder, timeout=60.0) as board, board.stream("camera", timeout=60.0) as stream:
        stream.read()
        print("ready", flush=True)
        sys.stdin.readline()
        before, frames, begun = stream.lost, 0, time.monotonic()
        while not frames or time.monotonic() < begun + seconds:
            int(stream.read()[0, 0])
            frames += 1
        print(frames / (time.monotonic() - begun), stream.lost - before)


if __name__ == "__main__":
    main(sys.argv[1], float(sys.argv[2]))
