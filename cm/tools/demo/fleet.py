# SPDX-License-Identifier: Apache-2.0
"""Three boards: one observes, another decides, the third acts; one is killed during a change of all, and comes back."""

from __future__ import annotations

import tempfile
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from cm.errors import Timeout
from cm.networks.fleet.blocking import Fleet, connect
from cm.networks.fleet.errors import ChangeFailed
from cm.tools.demo.boards import LocalFleet
from cm.tools.demo.course import Course, Picture
from cm.wire.messages.fleet import BoardStatus, Decision

EYE, MIND, HAND = "eye", "mind", "hand"
PICTURE = "fleet.png"
BUSY = 0.10  # share of strong edges above which a closer look is worth it
_PATIENCE = 120.0  # seconds
# Seconds after which a board that has heard nothing asks: the third when it is there again, but none before the change
# is decided, however busy the machine is.
_SETTLE = 15.0


def run_fleet_demo(out: Path) -> Path:
    """Run all of it; returns the path of the picture. Raises FleetFailed, Timeout, RequestFailed."""
    from cm.tools.demo.timeline import draw

    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="cmf-", dir="/tmp") as folder:
        local = LocalFleet((EYE, MIND, HAND), Path(folder))
        with local, connect(local.router, caller="demo", timeout=60.0) as fleet:
            _until(lambda: len(fleet.boards()) == 3 and all(_mode(fleet, name) for name in local.boards))
            course = Course()
            with _watched(fleet, course):
                _observe_decide_act(fleet, course)
                _change_with_a_death(fleet, local, course)
                _until(lambda: bool(course.modes[HAND]) and course.modes[HAND][-1][1] == "edge_detection")
            course.ended = course.now
    draw(course, out / PICTURE)
    return out / PICTURE


@contextmanager
def _watched(fleet: Fleet, course: Course) -> Iterator[None]:
    """What boards say goes into the course, from another thread."""
    over = threading.Event()
    with fleet.watch() as statuses:

        def follow() -> None:
            for name, status in statuses:
                if over.is_set():
                    return
                course.saw(name, status)

        thread = threading.Thread(target=follow, daemon=True)
        thread.start()
        _until(lambda: len(course.modes) == 3)
        try:
            yield
        finally:
            over.set()
            thread.join(_PATIENCE)  # boards say something each second


def _observe_decide_act(fleet: Fleet, course: Course) -> None:
    picture = np.array(fleet.frame(EYE, "camera"))
    course.say(EYE, f"observed a picture, mean brightness {picture.mean():.0f}")
    course.pictures.append(("eye: what the camera saw", picture))
    seconds = fleet.mode("loopback_edge", [MIND]).seconds
    course.say(MIND, f"has its edge detector after {seconds * 1000:.0f} ms")
    edges = _through_the_pl(fleet, picture)
    share = float(np.mean(edges > 64))
    course.pictures.append(("mind: its edges, from the PL", edges))
    zoom = 4 if share > BUSY else 2
    course.say(MIND, f"decided: {share:.0%} edges, a look with zoom {zoom}")
    fleet.mode("colorise", [HAND])
    fleet.write({"zoom": zoom}, [HAND])
    course.pictures.append(("hand: zoomed as decided", _settled_picture(fleet)))
    course.say(HAND, f"acted: colours, zoom {zoom}")


def _through_the_pl(fleet: Fleet, picture: Picture) -> Picture:
    """Send a picture through the second board's PL and back, again and again until the answer has come."""
    with ThreadPoolExecutor(1) as threads:
        answer = threads.submit(fleet.frame, MIND, "from_pl")
        while not answer.done():
            fleet.send(MIND, "to_pl", picture)
        return np.array(answer.result())


def _settled_picture(fleet: Fleet) -> Picture:
    """The second frame from now: the first may have begun before the register was written."""
    fleet.frame(HAND, "camera")
    return np.array(fleet.frame(HAND, "camera"))


def _change_with_a_death(fleet: Fleet, local: LocalFleet, course: Course) -> None:
    """All go to edge_detection; the third loses its power when it has prepared."""

    def tell(phase: str, board: str, _: object) -> None:
        if phase == "prepare" and board == HAND:
            course.say(HAND, "has prepared the change of all, and loses its power")
            local.boards[HAND].kill()

    try:
        fleet.mode("edge_detection", policy="quorum", timeout=60.0, settle=_SETTLE, tell=tell)
    except ChangeFailed as error:
        if error.outcome.decision is not Decision.KEEP:
            raise
        for board, why in error.outcome.differing.items():
            course.say(board, f"is named: {why}")
    course.say("fleet", "eye and mind are in edge_detection: two of three are enough")
    local.boards[HAND].start()
    course.say(HAND, "is there again")
    _until(lambda: _mode(fleet, HAND) == "edge_detection")
    course.say(HAND, "has asked what was decided, and is in edge_detection too")


def _mode(fleet: Fleet, board: str) -> str:
    status = fleet.status([board])[board]
    return status.status.mode if isinstance(status, BoardStatus) and not status.status.fpga_busy else ""


def _until(condition: Any) -> None:
    end = time.monotonic() + _PATIENCE
    while not condition():
        if time.monotonic() > end:
            raise Timeout("the demonstration did not go on")
        time.sleep(0.02)
