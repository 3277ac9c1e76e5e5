# SPDX-License-Identifier: Apache-2.0
"""What goes on beside the tests of the service, begun early: an emulated processor takes its time."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from board import RELEASE, Board

_SIMULATED = """
cm serve --sim --runtime-dir $HOME/sim --state-dir $HOME/state 2>log &
for i in $(seq 600); do grep -q 'ready at' log && break; sleep 0.2; done
cm configs --runtime-dir $HOME/sim || cat log
kill %1; wait
"""
_WHEEL = f"""
set -e
python3 -m pip install --no-index --quiet --break-system-packages --ignore-installed --no-deps --no-compile \\
    --target wheel {RELEASE}/*.whl
export PYTHONPATH=wheel
python3 -c "import cm.native._cm as m; print(m.__file__)"
python3 -m cm check /usr/lib/firmware/cm/camera/camera.yaml
"""


class Beside:
    """The simulated board, asked for without its package and installed then (bob); the wheel by pip (carol)."""

    def __init__(self, board: Board) -> None:
        self.wheel = board.booted.begin("bash -s", "carol", given=_WHEEL)
        self.refused = board.run("cm serve --sim --runtime-dir /tmp/sim", "bob")
        install = f"apt-get install -y {RELEASE}/fpga-cm-sim_*.deb && runuser -l bob -c 'bash -s'"
        self.simulated = board.booted.begin(install, given=_SIMULATED)


class Twins:
    """The board's power goes, with a mode loaded and a configuration just imported; two of it start again.

    `restarted` as it was, `write_protected` with a root file system that is read only, and its state in memory.
    """

    def __init__(self, board: Board, laptop: Path) -> None:
        with board.connected(laptop) as connected:
            connected.load("camera", "edge_detection")
        board.do("cm import archive /opt/cm/second.tar.gz")
        self._boards = restarted, write_protected = board.twin("restarted"), board.twin("write-protected")
        self._pool = ThreadPoolExecutor(2)
        self.restarted = self._pool.submit(_started, restarted)
        self.write_protected = self._pool.submit(_started, write_protected, "ro", "systemd.volatile=state")

    def close(self) -> None:
        """Switch them off."""
        self._pool.shutdown(wait=True)
        for board in self._boards:
            board.close()


def _started(board: Board, *arguments: str) -> Board:
    board.start(*arguments)
    board.until(lambda: board.unit("ActiveState") == "active")
    return board
