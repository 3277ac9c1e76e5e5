# SPDX-License-Identifier: Apache-2.0
"""What `make demo-open` ends with: modules that open tools built, loaded and run from their bits.

    python examples/open_camera.py BUILD.YAML    # after cm build run --flow open, cm build collect

The simulated board's region runs what the loaded frames configure (it needs Verilator). Each module says its
name in a register, and keeps what is written to another.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import cm

MODES = ("default", "edge_detection", "colorise")


def show(board: cm.Board) -> None:
    """Load each module, and print what its registers say."""
    for mode in MODES:
        board.load("open_camera", mode)
        name = int(board.registers["ident"]).to_bytes(4, "big").decode()
        board.registers["zoom"] = 4
        print(f"{mode}: its bits say {name!r}, zoom is {board.registers['zoom']} after 4 was written", flush=True)


def main(build: str) -> None:
    """Serve a board that runs its bits, and look at it."""
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
                show(board)
        finally:
            served.terminate()
            served.wait()


if __name__ == "__main__":
    main(sys.argv[1])
