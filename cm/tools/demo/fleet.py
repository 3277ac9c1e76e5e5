# SPDX-License-Identifier: Apache-2.0
"""Three boards: one observes, another decides, the third acts; one is killed during a change of all, and comes back."""

from __future__ import annotations

import shutil
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np

import cm
from cm.errors import NotInstalled
from cm.networks.fleet.blocking import Fleet, connect
from cm.networks.fleet.errors import ChangeFailed
from cm.tools.demo.boards import LocalFleet, local_etcd, until
from cm.tools.demo.timeline import Course, Picture
from cm.wire.messages.fleet import BoardStatus, Decision

EYE, MIND, HAND = "eye", "mind", "hand"
PICTURE = "fleet.png"
BUSY = 0.10  # share of strong edges above which a closer look is worth it
_PATIENCE = 120.0  # seconds
_SHOWN = 1.0  # seconds for which the drift stays, to be seen in the picture


def run_fleet_demo(out: Path, store: str = "keeper") -> Path:
    """Run all of it, with the wanted state in "keeper" or "etcd"; returns the path of the picture.

    Raises FleetFailed, Timeout, RequestFailed, NotInstalled.
    """
    from cm.tools.demo.timeline import draw

    if store == "etcd" and shutil.which("etcd") is None:
        raise NotInstalled("etcd is not installed (Debian: apt install etcd-server)")
    out.mkdir(parents=True, exist_ok=True)
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="cmf-", dir="/tmp")))
        where = stack.enter_context(local_etcd(folder / "etcd")) if store == "etcd" else ""
        local = stack.enter_context(LocalFleet((EYE, MIND, HAND), folder, store=where))
        fleet = stack.enter_context(connect(local.router, caller="demo", timeout=60.0, store=where or "keeper"))
        _until(lambda: len(fleet.inventory()) == 3 and all(_mode(fleet, name) for name in local.boards))
        course = Course()
        with _watched(fleet, course):
            _observe_decide_act(fleet, course)
            _change_with_a_death(fleet, local, course)
            _drift(fleet, local, course)
        course.ended = course.now
    draw(course, out / PICTURE)
    return out / PICTURE


@contextmanager
def _watched(fleet: Fleet, course: Course) -> Iterator[None]:
    """What boards say, and what is wanted of them, goes into the course, from other threads."""
    over = threading.Event()

    def follow_wanted() -> None:
        while not over.wait(0.05):
            for name, view in fleet.inventory().items():
                course.wants(name, view.wanted.mode if view.wanted else "")

    with fleet.watch() as statuses:

        def follow() -> None:
            for name, status in statuses:
                if over.is_set():
                    return
                course.saw(name, status)

        threads = [threading.Thread(target=each, daemon=True) for each in (follow, follow_wanted)]
        for thread in threads:
            thread.start()
        _until(lambda: len(course.modes) == 3)
        try:
            yield
        finally:
            over.set()
            for thread in threads:
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
        fleet.mode("edge_detection", policy="quorum", timeout=60.0, tell=tell)
    except ChangeFailed as error:
        if error.course.decision is not Decision.KEEP:
            raise
        for board, why in error.course.differing.items():
            course.say(board, f"is named: {why}")
    course.say("fleet", "eye and mind are in edge_detection: two of three are enough")
    local.boards[HAND].start()
    course.say(HAND, "is there again")
    _until(lambda: _mode(fleet, HAND) == "edge_detection")
    course.say(HAND, "has looked at what is wanted, and is in edge_detection too")


def _drift(fleet: Fleet, local: LocalFleet, course: Course) -> None:
    """Somebody at the second board takes it elsewhere; it is told, and taken back."""
    with cm.connect(runtime_dir=local.boards[MIND].runtime_dir) as board:
        board.mode = "default"
    _until(lambda: _state(fleet, MIND) == "drift")
    course.say(MIND, "was taken to default by hand, and says so: drift")
    time.sleep(_SHOWN)
    fleet.reconcile([MIND])
    _until(lambda: _mode(fleet, MIND) == "edge_detection")
    course.say(MIND, "was asked to reconcile: all are where they are wanted")


def _state(fleet: Fleet, board: str) -> str:
    status = fleet.status([board])[board]
    return status.fleet.state if isinstance(status, BoardStatus) and status.fleet else ""


def _mode(fleet: Fleet, board: str) -> str:
    status = fleet.status([board])[board]
    return status.status.mode if isinstance(status, BoardStatus) and not status.status.fpga_busy else ""


def _until(condition: Callable[[], object]) -> None:
    until(condition, "the demonstration did not go on")
