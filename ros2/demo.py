# SPDX-License-Identifier: Apache-2.0
"""``make demo-ros``: pictures of a simulated board, seen through a subscriber on another implementation of DDS.

Three processes: the manager on its simulated board, `cm bridge dds`, and a peer in C++ on eProsima Fast DDS, which has
no code of ours but the names of topics. The peer sees the latched status, a picture in each of three modes, and relays
the camera's pictures into the loop through the second region, whose output it sees again.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from PIL import Image

import cm
from cm import child
from cm.dds.local import loopback
from cm.testing.served import Served

PATIENCE = 120.0  # seconds, on a loaded machine
MODES = ("default", "edge_detection", "colorise")


class Timeline:
    """What happened when, printed as it happens."""

    def __init__(self) -> None:
        self._begun = time.monotonic()

    def tell(self, who: str, what: str) -> None:
        print(f"{time.monotonic() - self._begun:7.3f} s  {who:<8} {what}", flush=True)


class Peer:
    """The subscriber on Fast DDS."""

    def __init__(self, program: Path, domain: int) -> None:
        self._words = [str(program), str(domain)]
        self._environment = {**os.environ, "CM_PEER_LOOPBACK": "1"}

    def run(self, *words: str) -> str:
        """What it printed. Raises CalledProcessError."""
        done = subprocess.run(
            [*self._words, *words],
            stdout=subprocess.PIPE,
            text=True,
            env=self._environment,
            timeout=PATIENCE,
            check=True,
        )
        return done.stdout.strip()

    def start(self, *words: str) -> subprocess.Popen[str]:
        """The same, beside others."""
        return subprocess.Popen([*self._words, *words], stdout=subprocess.PIPE, text=True, env=self._environment)


@contextmanager
def bridge(runtime: Path, domain: int) -> Iterator[None]:
    """`cm bridge dds`, ready."""
    words = child.command("cm.cli.main", "bridge", "dds", "--runtime-dir", str(runtime), "--domain", str(domain))
    process = subprocess.Popen(words, stderr=subprocess.PIPE, env={**child.environment(), "CYCLONEDDS_URI": loopback()})
    assert process.stderr is not None
    try:
        while b"cm bridge: /" not in (line := process.stderr.readline()):
            if not line:
                raise SystemExit("the bridge did not start")
        yield
    finally:
        process.terminate()
        process.communicate(timeout=PATIENCE)


def play(board: cm.Board, peer: Peer, folder: Path, timeline: Timeline) -> list[tuple[str, Path]]:
    """The demonstration; the pictures that the peer wrote."""
    found: list[tuple[str, Path]] = []
    timeline.tell("fast dds", f"latched status: {peer.run('status', '/cm/status')}")
    for mode in MODES:
        board.mode = mode
        timeline.tell("board", f"is in mode {mode}")
        path = folder / f"{mode}.pnm"
        timeline.tell("fast dds", f"picture: {peer.run('picture', '/cm/camera/image_raw', str(path), '5')}")
        found.append((mode, path))
    board.mode = "default"
    board.mode = "loopback_edge"
    timeline.tell("board", "camera as it is; the loop through the second region finds edges")
    path = folder / "relayed.pnm"
    seeing = peer.start("picture", "/cm/from_pl/image_raw", str(path), "3")
    sending = peer.start("relay", "/cm/camera/image_raw", "/cm/to_pl/write", "100000")
    told, _ = seeing.communicate(timeout=PATIENCE)
    sending.kill()
    sending.communicate()
    if seeing.returncode:
        raise SystemExit("no picture came back from the loop")
    timeline.tell("fast dds", f"its own pictures, back from the board: {told.strip()}")
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
    parser.add_argument("--peer", type=Path, required=True, help="the compiled ros2/fastdds_peer")
    parser.add_argument("--out", type=Path, default=Path("demo-ros"))
    parser.add_argument("--domain", type=int, default=1 + os.getpid() % 100)
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    timeline = Timeline()
    served = Served("models", (str(Path(cm.__file__).parent / "data" / "camera"),))
    try:
        with cm.connect(str(served.runtime), timeout=PATIENCE) as board, tempfile.TemporaryDirectory() as folder:
            board.load("camera")
            timeline.tell("board", "the manager serves the camera example on a simulated board")
            with bridge(served.runtime, args.domain):
                timeline.tell("bridge", f"node /cm in DDS domain {args.domain}")
                pictures = play(board, Peer(args.peer, args.domain), Path(folder), timeline)
            sheet(pictures, args.out / "pictures.png")
    finally:
        served.stop()
    print(f"{args.out / 'pictures.png'}: {', '.join(name for name, _ in pictures)}", file=sys.stderr)


if __name__ == "__main__":
    main()
