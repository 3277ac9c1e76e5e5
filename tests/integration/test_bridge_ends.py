# SPDX-License-Identifier: Apache-2.0
"""SIGTERM ends each bridge, whatever it is waiting for: a change, a manager that hangs or has gone, a network."""

from __future__ import annotations

import os
import queue
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from manager_process import Manager, served, until

from cm.networks.fleet.bundles import described, where
from cm.networks.fleet.zenoh_session import Network, session
from cm.simulation.software import Board as SimBoard
from cm.wire.encode import encoded

pytest.importorskip("zenoh")
pytest.importorskip("xxhash")

import zenoh_support
from fleet_support import FleetBoard, fleet_board
from ros_peer import PATIENCE, BridgeProcess

pytestmark = pytest.mark.networks
MANY = 40  # more than are worked on at a time
PARAMETERS = "/cm/list_parameters", "rcl_interfaces/srv/ListParameters"
ACTION, KIND = "/cm/change_mode/_action", "cm_interfaces/action/ChangeMode"


class Node:
    """The node /cm, and a client."""

    def __init__(self, runtime: Path) -> None:
        self._router = zenoh_support.Router()
        self.bridge: BridgeProcess = zenoh_support.Bridge(runtime, self._router.where, "--patience", "600")
        self._peer = zenoh_support.Peer(self._router.where)

    def call(self, name: str, kind: str, **request: Any) -> dict[str, Any]:
        return self._peer.call(name, kind, **request)

    def send(self, name: str, kind: str, **request: Any) -> None:
        self._peer.send(name, kind, **request)

    def close(self) -> None:
        self._peer.close()
        self._router.close()


@pytest.fixture(scope="module")
def both() -> Iterator[tuple[Manager, SimBoard]]:
    """One manager with its board for all nodes in this file; the tests stop and continue them."""
    with served() as found:
        yield found


@pytest.fixture
def node(both: tuple[Manager, SimBoard]) -> Iterator[Node]:
    """A node that knows its board, with camera loaded."""
    with both[0].connected() as board:
        board.load("camera", "default", force=True)
    made = Node(both[0].runtime)
    until(lambda: made.call(*PARAMETERS)["result"]["names"], PATIENCE)
    yield made
    made.bridge.end()
    made.close()


def _ended_by_sigterm(bridge: BridgeProcess) -> None:
    status, said = bridge.stop(signal.SIGTERM)
    assert status == 0, said
    assert "Traceback" not in said


@contextmanager
def _stopped(pid: int) -> Iterator[None]:
    os.kill(pid, signal.SIGSTOP)
    try:
        yield
    finally:
        os.kill(pid, signal.SIGCONT)


def _until_busy(manager: Manager) -> None:
    with manager.connected() as board:
        until(lambda: board.status.fpga_busy, PATIENCE)


def test_a_bridge_ends_while_many_wait_for_a_change_and_answers_others_until_then(
    node: Node, both: tuple[Manager, SimBoard]
) -> None:
    manager, sim = both
    goal = {"goal_id": {"uuid": bytes(range(16))}, "goal": {"mode": "edge_detection"}}
    with _stopped(sim.pid):  # the change begins, but does not end
        assert node.call(f"{ACTION}/send_goal", f"{KIND}_SendGoal", **goal)["accepted"]
        _until_busy(manager)
        for _ in range(MANY):
            node.send(f"{ACTION}/get_result", f"{KIND}_GetResult", goal_id=goal["goal_id"])
            assert node.call(*PARAMETERS)["result"]["names"]
        refused = node.call("/cm/set_mode", "cm_interfaces/srv/SetMode", mode="colorise")
        assert (refused["code"], "24 requests wait" in refused["message"]) == ("busy", True)
        _ended_by_sigterm(node.bridge)


def test_a_bridge_ends_while_many_wait_for_a_manager_that_hangs(node: Node, both: tuple[Manager, SimBoard]) -> None:
    assert node.call("/cm/plan", "cm_interfaces/srv/Plan", mode="colorise")["success"]
    with _stopped(both[0].pid):
        for _ in range(MANY):
            node.send("/cm/plan", "cm_interfaces/srv/Plan", mode="colorise")
        _ended_by_sigterm(node.bridge)


def test_a_bridge_ends_whose_manager_has_gone_amid_a_change(node: Node, both: tuple[Manager, SimBoard]) -> None:
    manager, sim = both
    assert node.call("/cm/plan", "cm_interfaces/srv/Plan", mode="colorise")["success"]
    with _stopped(sim.pid):
        node.send("/cm/set_mode", "cm_interfaces/srv/SetMode", mode="colorise")
        _until_busy(manager)
        manager.kill()
        _ended_by_sigterm(node.bridge)
    manager.start()


# ---- the fleet's bridge ---------------------------------------------------------------------------


@pytest.fixture(scope="module")
def member() -> Iterator[tuple[FleetBoard, Any]]:
    """A board of a fleet, whose bridge each test restarts, and a session of its network."""
    router = zenoh_support.Router()
    ways = ("--router", router.where, "--import-to", "/dev/null/never")
    with fleet_board("b1", ways, guests='{"*": provision}') as board:
        there = session(Network("client", (f"tcp/{router.where}",)))
        yield board, there
        there.close()
    router.close()


@pytest.fixture
def met(member: tuple[FleetBoard, Any]) -> tuple[FleetBoard, Any]:
    """The same, once the network knows the bridge."""
    until(lambda: [reply for reply in member[1].get("cm/b1/status", timeout=PATIENCE) if reply.ok], PATIENCE)
    return member


def _ask(there: Any, key: str, payload: bytes | None = None) -> None:
    there.get(key, lambda _: None, payload=payload, timeout=PATIENCE)


def _until_taken(there: Any) -> None:
    """Wait until the bridge has taken earlier requests, which it does in order."""
    assert list(there.get("cm/b1/status", timeout=PATIENCE))


def _member_ended_by_sigterm(board: FleetBoard) -> None:
    process = board.bridge.process
    assert process is not None
    process.send_signal(signal.SIGTERM)
    _, said = process.communicate(timeout=PATIENCE)
    assert (process.returncode, b"Traceback" in said, b"is away" in said) == (0, False, False), said


def test_a_fleets_bridge_ends_while_many_wait_for_a_change(met: tuple[FleetBoard, Any]) -> None:
    board, there = met
    with _stopped(board.sim.pid):
        for _ in range(MANY):
            _ask(there, "cm/b1/do/mode/anna?format=json", b'{"mode": "edge_detection"}')
        _until_taken(there)
        _member_ended_by_sigterm(board)
    board.bridge.start()


def test_a_fleets_bridge_ends_while_many_wait_for_a_manager_that_hangs(met: tuple[FleetBoard, Any]) -> None:
    board, there = met
    with _stopped(board.manager.pid):
        for _ in range(MANY):
            _ask(there, "cm/b1/reg/*")
            _ask(there, "cm/b1/do/mode/anna?format=json", b'{"mode": "default"}')
        _until_taken(there)
        _member_ended_by_sigterm(board)
    board.bridge.start()


def test_a_fleets_bridge_ends_while_it_fetches_an_archive(met: tuple[FleetBoard, Any], tmp_path: Path) -> None:
    board, there = met
    held: queue.Queue[Any] = queue.Queue()
    offer = there.declare_queryable(where("*"), held.put)
    archive = tmp_path / "a"
    archive.write_bytes(bytes(2 << 20))
    _ask(there, "cm/b1/do/bundle/anna", encoded(described(archive)))
    query = held.get(timeout=PATIENCE)  # and not answered
    _member_ended_by_sigterm(board)
    board.bridge.process = None
    del query
    offer.undeclare()
