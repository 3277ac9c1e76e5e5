# SPDX-License-Identifier: Apache-2.0
"""What goes on beside the tests of the service, begun early: an emulated processor takes its time."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from board import RELEASE, Board
from vmboard.pages import documented

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
python3 -c "import cm.device.native._cm as m; print(m.__file__)"
python3 -m cm check /usr/lib/firmware/cm/camera/camera.yaml
"""
# The keys of a fleet whose router runs on the board, and what the page has a board's owner do before the unit starts.
_KEEPS = "sudo sed -i 's,^ARGUMENTS=.*,& --keeper,' /etc/cm/bridge-fleet.conf"
_FLEET = """
cm fleet keys fleet router --host 127.0.0.1
cm fleet keys fleet board b1 --keeper
for name in anna olga; do cm fleet keys fleet client $name --role operate; done
cd fleet
"""
_INDEX = "printf '[global]\\nno-index = true\\nfind-links = /opt/cm/wheels\\n' >/etc/pip.conf"


def library(bridge: str) -> str:
    """What the owner of a board edits where pip has put the bridge's library."""
    return f"sudo sed -i 's,^#PYTHONPATH,PYTHONPATH,' /etc/cm/bridge-{bridge}.conf"


class Beside:
    """The simulated board, asked for without its package and installed then (bob); the wheel by pip (carol).

    Keys of a fleet, and the library of its bridge (alice).
    """

    def __init__(self, board: Board) -> None:
        board.do(_INDEX)  # pip finds what the disk has
        block = documented("docs/fleet.md", "enable --now cm-bridge@fleet")
        edit = next(line for line in block.splitlines() if "sudo editor" in line)
        block = block.replace(edit, f"{library('fleet')}; {_KEEPS}")
        before, self.starting_the_bridge = block.split("sudo systemctl", 1)
        self.fleet = board.booted.begin("bash -exs", "alice", given=_FLEET + before)
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
