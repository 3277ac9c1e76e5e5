# SPDX-License-Identifier: Apache-2.0
"""The bridges' units in systemd's hands, set up as docs/fleet.md says; the fleet's router runs on the board, too."""

from __future__ import annotations

import re
from collections.abc import Iterator

import pytest
from beside import Beside, library
from board import Board
from vmboard.pages import documented

_ANNA = "PYTHONPATH=/opt/cm-bridge cm fleet {} --zenoh-config fleet/anna.json5"
_ROUTER = (
    "systemd-run --unit=fleet-router --uid=alice -E PYTHONPATH=/opt/cm-bridge "
    "/usr/bin/cm fleet router --zenoh-config /home/alice/fleet/router.json5"
)


def _property(board: Board, bridge: str, name: str) -> str:
    return board.do(f"systemctl show --value -p {name} cm-bridge@{bridge}").strip()


def _said(board: Board, bridge: str) -> str:
    """By the bridge, since the board was started."""
    return board.do(f"journalctl -b --no-pager -o cat -u cm-bridge@{bridge}")


@pytest.fixture(scope="module")
def member(board: Board, beside: Beside) -> Iterator[Board]:
    """The board as a member of a fleet."""
    access = documented("docs/fleet.md", "roles: {fleet")
    board.do("cp /etc/cm/cm.yaml /root/cm.yaml && cat >>/etc/cm/cm.yaml && systemctl reload cm", given=access)
    made = beside.fleet()
    assert made.status == 0, made.said
    board.do(_ROUTER)
    board.do("bash -exs", "alice", given=f"sudo systemctl{beside.starting_the_bridge}")
    board.until(lambda: "ready as b1" in _said(board, "fleet"))
    yield board
    board.do("systemctl stop fleet-router; systemctl disable --now cm-bridge@fleet")
    board.do("cp /root/cm.yaml /etc/cm/cm.yaml; systemctl reload cm")


def test_the_fleets_bridge_runs_as_its_own_user_without_a_capability(member: Board) -> None:
    assert (_property(member, "fleet", "ActiveState"), _property(member, "fleet", "NRestarts")) == ("active", "0")
    status = dict(re.findall(r"(\w+):\s+(.*)", member.do(f"cat /proc/{_property(member, 'fleet', 'MainPID')}/status")))
    numbers = member.do("id -u cm-bridge; getent group fpga | cut -d : -f 3").split()
    assert (status["Uid"].split(), status["Gid"].split()) == ([numbers[0]] * 4, [numbers[1]] * 4)
    assert int(status["CapEff"], 16) == 0
    assert (status["NoNewPrivs"], status["Seccomp"]) == ("1", "2")


def test_the_managers_policy_knows_callers_by_the_names_in_their_certificates(member: Board) -> None:
    member.do("cm load camera", "alice")
    member.do(_ANNA.format("load camera/edge_detection"), "alice")
    assert '"mode": "edge_detection"' in member.do("cm status --json", "alice")
    refused = member.run(_ANNA.format("mode colorise").replace("anna", "olga"), "alice")
    assert (refused.status, "zenoh:olga" in refused.said) == (1, True), refused.said


def test_it_outlives_its_manager_and_is_restarted_where_it_dies_itself(member: Board) -> None:
    before = _property(member, "fleet", "MainPID")
    member.do("systemctl restart cm")
    member.until(lambda: "edge_detection" in member.run(_ANNA.format("status"), "alice").out)
    assert _property(member, "fleet", "MainPID") == before
    member.do(f"kill -9 {before}")
    member.until(lambda: _said(member, "fleet").count("ready as b1") == 2)
    assert _property(member, "fleet", "NRestarts") == "1"


def test_it_stops_when_it_is_told_to(member: Board) -> None:
    member.do("systemctl stop cm-bridge@fleet")
    ends = [_property(member, "fleet", name) for name in ("Result", "ExecMainCode", "ExecMainStatus")]
    assert ends == ["success", "1", "0"]
    assert "Traceback" not in _said(member, "fleet")


def test_a_bridge_whose_library_is_missing_says_so_once(member: Board) -> None:
    """The fleet's is there already; xxhash, which ROS's ends need, is not."""
    member.do(library("ros"))
    member.do("systemctl start cm-bridge@ros")
    member.until(lambda: _property(member, "ros", "ActiveState") == "failed")
    assert (_property(member, "ros", "ExecMainStatus"), _property(member, "ros", "NRestarts")) == ("78", "0")
    assert _said(member, "ros").count("needs eclipse-zenoh and xxhash") == 1


def test_a_ros_node_starts_and_stops(member: Board) -> None:
    member.do("pip install --target /opt/cm-bridge xxhash")
    member.do("systemctl start cm-bridge@ros")
    member.until(lambda: "cm bridge: /cm" in _said(member, "ros"))
    member.do("systemctl stop cm-bridge@ros")
    assert [_property(member, "ros", name) for name in ("Result", "ExecMainStatus")] == ["success", "0"]
    assert "Traceback" not in _said(member, "ros")
