# SPDX-License-Identifier: Apache-2.0
"""The paper's Listing 2 as a program: observe, decide, act. It knows the manager by its sockets only.

Run as ``python -m cm.tools.demo.application RUNTIME_DIR FRAMES.npz``.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import zmq

from cm.wire import cm_pb2 as pb

Picture = np.ndarray[Any, np.dtype[np.uint8]]

PICTURES = 3  # photographs to see in each mode before going on
TIMEOUT_MS = 60_000  # of silence; on a loaded machine a picture may take seconds
BUSY = 0.10  # share of edge pixels in the centre above which a closer look is worth it


class NothingCame(RuntimeError):
    """The manager has sent nothing for too long."""


@dataclass
class Observation:
    """What was seen in one mode: distinct pictures, in the order they came."""

    label: str
    pictures: list[Picture] = field(default_factory=list)

    def add(self, picture: Picture) -> None:
        """Keep a picture if it differs from the last one."""
        if not self.pictures or not np.array_equal(self.pictures[-1], picture):
            self.pictures.append(picture)


class Application:
    """Two sockets, as in the listing: one to listen, one to act."""

    def __init__(self, runtime_dir: Path) -> None:
        context = zmq.Context.instance()
        self.listener = context.socket(zmq.SUB)
        self.listener.setsockopt(zmq.RCVHWM, 4)
        self.listener.connect(f"ipc://{runtime_dir}/pub")
        self.actor = context.socket(zmq.XPUB)  # a PUB that is told of subscriptions
        self.actor.connect(f"ipc://{runtime_dir}/sub")
        self.listener.setsockopt(zmq.SUBSCRIBE, b"cm_status")
        self.listener.setsockopt(zmq.SUBSCRIBE, b"cm_read_data")
        if not self.actor.poll(TIMEOUT_MS):  # what is sent before the manager listens is lost
            raise NothingCame("the configuration manager does not listen")
        self.actor.recv()
        self.status = pb.Status()

    # ---- observe --------------------------------------------------------------------

    def next_picture(self) -> tuple[Picture, str]:
        """The next camera frame and the mode it was made in."""
        while True:
            topic, message, *payload = self._receive()
            if topic == b"cm_status":
                self.status.ParseFromString(message)
            elif topic == b"cm_read_data":
                frame = pb.Frame.FromString(message)
                if frame.stream == "camera":
                    return np.frombuffer(payload[0], frame.dtype).reshape(frame.shape), frame.mode

    def _receive(self) -> list[bytes]:
        if not self.listener.poll(TIMEOUT_MS):
            raise NothingCame("nothing came from the configuration manager")
        return self.listener.recv_multipart()

    def observe(self, label: str) -> Observation:
        """Look until every photograph has come by."""
        seen = Observation(label)
        while len(seen.pictures) < PICTURES:
            picture, _ = self.next_picture()
            seen.add(picture)
        return seen

    # ---- act ------------------------------------------------------------------------

    def change_mode(self, text: str, mode: str) -> float:
        """Ask for a mode in plain text; seconds until the first frame made in it."""
        started = time.monotonic()
        self.actor.send_multipart([b"cm_config", text.encode()])
        while self.next_picture()[1] != mode:
            pass
        return time.monotonic() - started

    def write_register(self, text: str, before: Picture) -> float:
        """Write registers in plain text; seconds until the first frame that looks different."""
        started = time.monotonic()
        self.actor.send_multipart([b"cm_write_reg", text.encode()])
        while np.array_equal(self.next_picture()[0], before):
            pass
        return time.monotonic() - started


def edge_share(picture: Picture) -> float:
    """Share of strong edges in the middle of an edge picture."""
    height, width = picture.shape[:2]
    centre = picture[height // 4 : -height // 4, width // 4 : -width // 4]
    return float(np.mean(centre > 64))


def run(app: Application) -> list[Observation]:
    """Observe, decide, act: from the plain picture to the zoomed one."""
    plain = app.observe("default")
    brightness = float(np.mean(plain.pictures[0]))
    say(f"observed  default         {PICTURES} pictures, mean brightness {brightness:.0f}")

    seconds = app.change_mode("edge", "edge_detection")
    edges = app.observe("edge detection")
    shares = [edge_share(p) for p in edges.pictures]
    say(f"acted     edge detection  first frame after {seconds * 1000:6.1f} ms")
    say("observed  edge detection  edges in the centre: " + ", ".join(f"{s:.0%}" for s in shares))

    seconds = app.change_mode("colorise", "colorise")
    colours = app.observe("colorise")
    say(f"acted     colorise        first frame after {seconds * 1000:6.1f} ms")

    zoom = 4 if max(shares) > BUSY else 2
    seconds = app.write_register(f"{{ 'zoom':{zoom:#x}}}", colours.pictures[-1])
    say(f"decided   zoom {zoom}          first frame after {seconds * 1000:6.1f} ms (a register, no reconfiguration)")
    closer = app.observe(f"colorise, zoom {zoom}")
    return [plain, edges, colours, closer]


def say(text: str) -> None:
    """Tell what was done, at once."""
    print(text, flush=True)


def main(arguments: list[str]) -> int:
    """Run the loop and keep what was seen; the exit status."""
    runtime_dir, output = Path(arguments[0]), Path(arguments[1])
    try:
        seen = run(Application(runtime_dir))
    except NothingCame as error:
        print(f"demo: {error}", file=sys.stderr)
        return 1
    named: dict[str, Any] = {f"{i} {x.label} {j}": p for i, x in enumerate(seen) for j, p in enumerate(x.pictures)}
    np.savez(output, **named)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
