# SPDX-License-Identifier: Apache-2.0
"""A fleet behind a router with certificates and rules: who may do what, as the router and the manager see it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from fleet_support import FleetBoard, Router, fleet_board
from manager_process import until

import cm.fleet
from cm.networks.fleet.security.access_rules import Member
from cm.networks.fleet.security.keys_folder import KeyFolder
from cm.networks.fleet.store import StoreAway
from cm.networks.fleet.zenoh_session import NoNetwork
from cm.tools.demo.boards import free_ports
from cm.wire.messages.fleet import BoardStatus
from cm.wire.messages.status import ErrorInfo, RegValues

pytestmark = pytest.mark.networks


class Closed:
    """A fleet with keys: one board, and clients' files by their names."""

    def __init__(self, keys: KeyFolder, board: FleetBoard) -> None:
        self.keys = keys
        self.board = board

    def connected(self, name: str, caller: str = "", patience: float = 60.0) -> cm.fleet.Fleet:
        """`patience`: seconds to wait for an answer, all of which pass if there is none."""
        found = cm.fleet.connect(config=self.keys.folder / f"{name}.json5", caller=caller, timeout=patience)
        until(lambda: len(found.boards()) == 2, 60.0)
        return found


@pytest.fixture(scope="module")
def closed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Closed]:
    keys, port = KeyFolder(tmp_path_factory.mktemp("fleet") / "keys"), free_ports()
    keys.router(("127.0.0.1",), 30, port)
    for member in (
        Member("b1", "board", keeper=True),
        Member("b2", "board"),
        Member("anna", "client", "operate"),
        Member("olga", "client"),
        Member("nina", "client", "operate", ("b1",)),
        Member("omar", "client", "operate", ("b2",)),
    ):
        keys.add(member, 30)
    router = Router(keys.folder / "router.json5", listen=False)
    guests = '{"zenoh:anna": operate, "zenoh:nina": observe}'
    bridges = {name: ("--zenoh-config", str(keys.folder / f"{name}.json5")) for name in ("b1", "b2")}
    with (
        fleet_board("b1", (*bridges["b1"], "--keeper"), guests=guests) as board,
        fleet_board("b2", bridges["b2"], guests=guests),
    ):
        yield Closed(keys, board)
    router.kill()


def error_of(found: dict[str, RegValues | ErrorInfo]) -> ErrorInfo:
    error = found["b1"]
    assert isinstance(error, ErrorInfo), error
    return error


def test_an_operator_changes_modes_and_registers_under_the_name_in_its_certificate(closed: Closed) -> None:
    with closed.connected("anna") as fleet:
        assert fleet.caller == "anna"
        fleet.mode("edge_detection")
        assert all(status.status.mode == "edge_detection" for status in fleet.status().values())
        assert isinstance(fleet.write({"led": 1})["b1"], RegValues)
        fleet.mode("default")


def test_who_may_operate_some_boards_only_reads_the_wanted_state_and_writes_none(closed: Closed) -> None:
    """A transaction may be about any boards. A board puts its own settings there, and nothing else."""
    with closed.connected("nina", patience=5.0) as fleet:
        assert set(fleet.inventory()) == {"b1", "b2"}  # with a certificate it has joined by itself
        with pytest.raises(StoreAway, match="rules keep us off"):
            fleet.mode("edge_detection")


def test_an_observer_sees_everything_and_the_router_drops_its_commands(closed: Closed) -> None:
    with closed.connected("olga") as fleet:
        assert isinstance(fleet.status()["b1"], BoardStatus)
        with fleet.watch() as statuses:
            assert next(statuses)[0] in ("b1", "b2")
    with closed.connected("olga", patience=5.0) as fleet:
        assert "rules keep us off" in error_of(fleet.write({"led": 2})).message


def test_no_client_speaks_in_the_name_of_another(closed: Closed) -> None:
    with closed.connected("olga", caller="anna", patience=5.0) as fleet:
        assert error_of(fleet.write({"led": 3}, ["b1"])).code == "no_answer"


def test_what_the_router_lets_through_the_managers_policy_may_still_refuse(closed: Closed) -> None:
    with closed.connected("nina") as fleet:
        error = error_of(fleet.write({"led": 2}))
        assert (error.code, "zenoh:nina" in error.message) == ("forbidden", True)


def test_a_client_that_may_see_one_board_asks_for_all_and_sees_that_one(closed: Closed) -> None:
    """A query for all boards is dropped, because rules match by inclusion; the client then asks by name."""
    with closed.connected("nina") as fleet:
        assert isinstance(fleet.status()["b1"], BoardStatus)
    with closed.connected("omar", patience=5.0) as fleet:
        found = fleet.status()["b1"]
        assert isinstance(found, ErrorInfo)
        assert found.code == "no_answer"


def test_no_client_connects_without_a_certificate_of_the_fleet(closed: Closed, tmp_path: Path) -> None:
    other = KeyFolder(tmp_path / "other")
    other.router(("127.0.0.1",), 30, port_of(closed))
    other.add(Member("anna", "client", "operate"), 30)
    path = other.folder / "anna.json5"
    path.write_text(path.read_text().replace('"timeout_ms": 3000', '"timeout_ms": 1000'))
    with pytest.raises(NoNetwork):
        cm.fleet.connect(config=path, timeout=1.0)


def port_of(closed: Closed) -> int:
    said = json.loads((closed.keys.folder / "members.json").read_text())["router"]
    return int(said.rpartition(":")[2])
