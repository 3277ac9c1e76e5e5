# SPDX-License-Identifier: Apache-2.0
"""The first frames of a board: ten of noise through each module of the design `loop`, and what came back."""

from __future__ import annotations

import numpy as np

import cm

SHAPE, COUNT = (480, 640), 10


def main() -> None:
    """Send and compare; prints a line for each mode."""
    noise = np.random.default_rng(1)
    with cm.connect() as board:
        for mode in ("default", "edges"):
            board.mode = mode
            same = came = 0
            with board.stream("from_pl", timeout=5) as stream, board.writer("to_pl", timeout=5) as writer:
                for _ in range(COUNT):
                    sent = noise.integers(0, 256, SHAPE, dtype=np.uint8)
                    writer.write(sent)
                    try:
                        frame = stream.read()
                    except cm.Timeout:
                        continue
                    came += 1
                    same += bool((np.asarray(frame) == sent).all())
                    del frame
            print(f"{mode}: {came} of {COUNT} frames came, {same} of them as they were sent")


if __name__ == "__main__":
    main()
