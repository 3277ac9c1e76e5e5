# SPDX-License-Identifier: Apache-2.0
"""``make demo-ros``: pictures of a simulated board, seen by a node of others' making.

Where ROS 2 is sourced, the board is served by `cm_ros2`, and the other node is one of rclpy; elsewhere by `cm bridge
ros`, and the other is zenoh_ros2_sdk's. It sees the latched status, a picture in each of three modes, and relays the
camera's pictures into the loop through the second region, whose output it sees again.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from importlib.util import find_spec
from pathlib import Path

from PIL import Image

import cm
from cm import child
from cm.tools.testing.served import Served

HERE = Path(__file__).resolve().parent
PATIENCE = 120.0  # seconds, on a loaded machine
MODES = ("default", "edge_detection", "colorise")

Ask = Callable[..., str]


class Timeline:
    """What happened when, printed as it happens."""

    def __init__(self) -> None:
        self._begun = time.monotonic()

    def tell(self, who: str, what: str) -> None:
        print(f"{time.monotonic() - self._begun:7.3f} s  {who:<8} {what}", flush=True)


@contextmanager
def running(words: list[str], environment: dict[str, str], **pipes: int) -> Iterator[subprocess.Popen[bytes]]:
    """A process, until the end of the block."""
    process = subprocess.Popen(words, env={**child.environment(), **environment}, **pipes)  # type: ignore[call-overload]
    try:
        yield process
    finally:
        process.terminate()
        process.communicate(timeout=PATIENCE)


@contextmanager
def light_route(runtime: Path) -> Iterator[list[str]]:
    """`cm bridge ros` and a router; the other node's command."""
    from cm.tools.bench.peers.zenoh_pictures import routing

    router, where = routing()
    words = child.command("cm.cli.main", "bridge", "ros", "--runtime-dir", str(runtime), "--write", "frames")
    with running([*words, "--router", where], {"ROS_DOMAIN_ID": "0"}, stderr=subprocess.PIPE) as bridge:
        assert bridge.stderr is not None
        while b"cm bridge: /" not in (line := bridge.stderr.readline()):
            if not line:
                raise SystemExit("the bridge did not start")
        yield [sys.executable, str(HERE / "demo_peer.py"), where]
    router.close()


@contextmanager
def ros(runtime: Path) -> Iterator[list[str]]:
    """`cm_ros2`, from the sources here; the other node's command."""
    os.environ["ROS_DOMAIN_ID"] = str(1 + os.getpid() % 100)
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    path = os.pathsep.join([str(HERE / "cm_ros2"), str(HERE.parent), os.environ.get("PYTHONPATH", "")])
    arguments = ["--ros-args", "-r", "__node:=cm", "-p", f"connect:={runtime}", "-p", "write:=frames"]
    with running([sys.executable, "-m", "cm_ros2.node", *arguments], {"PYTHONPATH": path}):
        yield [sys.executable, str(HERE / "demo_peer.py")]


@contextmanager
def asking(words: list[str]) -> Iterator[Ask]:
    """The other node: what it is told, and what it answers."""
    with running(words, {}, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as peer:
        given, told = peer.stdin, peer.stdout
        assert given is not None
        assert told is not None

        def ask(*command: object) -> str:
            given.write(f"{' '.join(map(str, command))}\n".encode())
            given.flush()
            if not (line := told.readline()):
                raise SystemExit(f"the other node did not do this: {' '.join(map(str, command))}")
            return line.decode().strip()

        yield ask
        given.close()  # by which it ends
        peer.wait(PATIENCE)
        peer.stdin = None


def play(board: cm.Board, ask: Ask, relaying: Ask, folder: Path, timeline: Timeline) -> list[tuple[str, Path]]:
    """The demonstration; the pictures that the other node wrote."""
    found: list[tuple[str, Path]] = []
    timeline.tell("other", f"latched status: {ask('status', '/cm/status')}")
    for mode in MODES:
        board.mode = mode
        timeline.tell("board", f"is in mode {mode}")
        path = folder / f"{mode}.pnm"
        timeline.tell("other", f"picture: {ask('picture', '/cm/camera/image_raw', path, 5)}")
        found.append((mode, path))
    board.mode = "default"
    board.mode = "loopback_edge"
    timeline.tell("board", "camera as it is; the loop through the second region finds edges")
    path = folder / "relayed.pnm"
    relaying("relay", "/cm/camera/image_raw", "/cm/to_pl/write")
    timeline.tell("other", f"its own pictures, back from the board: {ask('picture', '/cm/from_pl/image_raw', path, 3)}")
    return [*found, ("relayed into the loop", path)]


def sheet(pictures: list[tuple[str, Path]], target: Path) -> None:
    """All beside each other, at half their size."""
    images = [Image.open(path).convert("RGB").reduce(2) for _, path in pictures]
    whole = Image.new("RGB", (sum(image.width for image in images), images[0].height))
    left = 0
    for image in images:
        whole.paste(image, (left, 0))
        left += image.width
    whole.save(target)


def main() -> None:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("demo-ros"))
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    there = find_spec("rclpy") is not None and find_spec("cm_interfaces") is not None
    timeline = Timeline()
    served = Served("models", (str(Path(cm.__file__).parent / "data" / "camera"),))
    try:
        with ExitStack() as stack:
            board = stack.enter_context(cm.connect(str(served.runtime), timeout=PATIENCE))
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
            board.load("camera")
            timeline.tell("board", "the manager serves the camera example on a simulated board")
            words = stack.enter_context((ros if there else light_route)(served.runtime))
            what = (
                "cm_ros2, for a node of rclpy" if there else "cm bridge ros, for a node of zenoh_ros2_sdk: no ROS here"
            )
            timeline.tell("bridge", f"node /cm: {what}")
            ask, relaying = stack.enter_context(asking(words)), stack.enter_context(asking(words))
            pictures = play(board, ask, relaying, folder, timeline)
            sheet(pictures, args.out / "pictures.png")
    finally:
        served.stop()
    print(f"{args.out / 'pictures.png'}: {', '.join(name for name, _ in pictures)}", file=sys.stderr)


if __name__ == "__main__":
    main()
