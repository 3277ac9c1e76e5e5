# SPDX-License-Identifier: Apache-2.0
"""An archive over a link of 64 kbit/s, and changes meanwhile, which go first."""

from __future__ import annotations

import hashlib
import random
import statistics
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from fleet_support import FleetBoard, Router, fleet_board
from manager_process import until
from networks import HOST, Networks, needs_root

import cm.fleet
from cm.design.collect.collected import archive
from cm.networks.fleet.blocking import Fleet
from cm.wire.messages.fleet import BundleState

RATE = 64e3  # bit/s
_SCHEMA = """
config:
  name: vision
  modules:
    edge: {{bitstream: edge.bin, sha256: {sha256}}}
  modes:
    contours: {{modules: [edge]}}
"""


@pytest.fixture
def two(tmp_path: Path) -> Iterator[tuple[Networks, Fleet, dict[str, FleetBoard]]]:
    """One of which is behind a thin link."""
    with Networks(("b1", "b2")) as networks:
        router = Router(host=networks.address(HOST))
        where = ("--router", router.endpoint, "--join", "--import-to", str(tmp_path / "imports"))
        guests = '{"*": provision}'
        try:
            with (
                fleet_board("b2", (*where, "--keeper"), guests=guests, inside=networks.inside("b2")) as b2,
                fleet_board("b1", where, guests=guests, inside=networks.inside("b1")) as b1,
                cm.fleet.connect(router.endpoint, caller="anna", timeout=30.0, store="keeper") as fleet,
            ):
                until(lambda: set(fleet.inventory()) == {"b1", "b2"})
                fleet.load("camera", "default")
                networks.set("b1", rate=RATE, queue=2.0)
                yield networks, fleet, {"b1": b1, "b2": b2}
        finally:
            router.kill()


def changes(fleet: Fleet, boards: str, over: threading.Event, most: int) -> float:
    """Median of the seconds of some changes."""
    took = []
    for number in range(most):
        if over.is_set():
            break
        took.append(fleet.mode(("edge_detection", "default")[number % 2], boards).seconds)
        time.sleep(2.0)
    return statistics.median(took)


@needs_root
@pytest.mark.timeout(900)
def test_an_archive_comes_over_a_thin_link_and_changes_go_first(
    two: tuple[Networks, Fleet, dict[str, FleetBoard]], tmp_path: Path, in_long: bool
) -> None:
    _, fleet, _ = two
    length = 2_000_000 if in_long else 200_000
    data, over = random.Random(1).randbytes(length), threading.Event()
    path = tmp_path / "vision.tar.gz"
    schema = _SCHEMA.format(sha256=hashlib.sha256(data).hexdigest())
    path.write_bytes(archive("vision", {"vision.yaml": schema.encode(), "edge.bin": data}))
    before = {boards: changes(fleet, boards, over, 6 if in_long else 3) for boards in ("b1", "b2")}
    outcome: dict[str, object] = {}
    begun = time.monotonic()

    def push() -> None:
        outcome.update(fleet.push(path, ["b1"]))
        over.set()

    work = threading.Thread(target=push)
    work.start()
    time.sleep(5.0)
    meanwhile = {boards: changes(fleet, boards, over, 6 if in_long else 2) for boards in ("b1", "b2")}
    work.join(900.0)
    took = time.monotonic() - begun
    print(f"{length} bytes at {RATE / 1e3:g} kbit/s: {took:.0f} s; changes before {before}, meanwhile {meanwhile}")
    state = outcome["b1"]
    assert isinstance(state, BundleState)
    assert (state.config_name, state.error) == ("vision", None)
    assert took < 1.44 * 8 * length / RATE + (0.0 if in_long else 30.0)  # 2 MB in six minutes
    assert meanwhile["b2"] <= 2 * before["b2"]
    assert meanwhile["b1"] <= (2 if in_long else 3) * before["b1"]  # one piece may stand before its first words
