# SPDX-License-Identifier: Apache-2.0
"""What `make demo-open` ends with: a photograph through modules that open tools built, each simulated from its bits.

    python examples/open_camera.py BUILD.YAML [SHEET.PNG]    # after cm build run --flow open, cm build collect

The simulated board's region runs what the loaded frames configure (it needs Verilator). Each module says its
name in a register; the picture goes from memory to it and back by the streams of the ordinary client, as on a board.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

import cm
from cm.simulation.software.hardware.camera import shipped_photos
from cm.tools.demo.sheet import contact_sheet

MODES = ("default", "edge_detection", "colorise")


def through(board: cm.Board, photo: np.ndarray) -> np.ndarray:
    """The picture that comes back."""
    with board.stream("camera", timeout=60) as results, board.writer("pictures", timeout=60) as writer:
        writer.write(photo)
        return np.array(results.read())


def show(board: cm.Board, photo: np.ndarray) -> dict[str, list[np.ndarray]]:
    """Load each module; print what its registers say; a picture through it."""
    rows = {"from memory": [photo]}
    for mode in MODES:
        board.load("open_camera", mode)
        name = int(board.registers["ident"]).to_bytes(4, "big").decode()
        picture = through(board, photo)
        rows[f"{mode}, by its bits"] = [picture]
        count = int(board.registers["frame_count"])
        size = "×".join(map(str, picture.shape))
        print(f"{mode}: its bits say {name!r}, a picture of {size} came back, {count} counted", flush=True)
    return rows


def main(build: str, sheet: str = "") -> None:
    """Serve a board that runs its bits, and look at it."""
    photo = next(iter(shipped_photos().values()))
    out = Path(sheet) if sheet else Path(build).parent / "open_camera.png"
    with tempfile.TemporaryDirectory(prefix="cm-open-") as folder:
        command = [sys.executable, "-m", "cm", "serve", "--sim=bits", "--build", build, "--runtime-dir", folder]
        command += ["--state-dir", str(Path(folder) / "state")]
        served = subprocess.Popen(command, stderr=subprocess.DEVNULL)
        wait = [sys.executable, "-m", "cm", "status", "--wait", "5", "--runtime-dir", folder]
        try:  # the first start compiles the board and every module
            while subprocess.run(wait, check=False, capture_output=True).returncode:
                if served.poll() is not None:
                    sys.exit("cm serve --sim=bits ended: start it by hand to see why")
            with cm.connect(runtime_dir=folder, timeout=60) as board:
                contact_sheet(show(board, photo), out)
        finally:
            served.terminate()
            served.wait()
    print(f"the pictures are in {out}")


if __name__ == "__main__":
    main(*sys.argv[1:])
