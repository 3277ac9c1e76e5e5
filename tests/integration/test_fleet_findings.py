# SPDX-License-Identifier: Apache-2.0
"""What was found by killing and stopping a fleet's processes at every step, over both stores (etcd: `make test-fleet`).

1: a board that was away; 2: clocks; 3: who is missing; 4: a dead coordinator; 5: registers.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from fleet_etcd import EtcdCluster
from fleet_support import CLOCK, FleetBoard, Router, fleet_of
from manager_process import REPOSITORY, environment, until

from cm.cli.main import main
from cm.networks.fleet.blocking import Fleet
from cm.networks.fleet.coordinator import LEASE
from cm.networks.fleet.errors import ChangeFailed, FleetRefused
from cm.networks.fleet.store import StoreAway
from cm.wire.messages.fleet import BoardStatus, FleetState
from cm.wire.messages.status import RegValues

pytestmark = pytest.mark.networks
Boards = dict[str, FleetBoard]
STORES = ["keeper", *(["etcd"] if os.environ.get("CM_ETCD") else [])]
ENDS = LEASE + 5.0  # seconds after which no board may be undecided
BUSY = 30.0  # further seconds that a busy machine may take for what follows


@pytest.fixture(scope="module", params=STORES)
def store(request: pytest.FixtureRequest) -> Iterator[str]:
    if request.param == "keeper":
        yield "keeper"
        return
    with EtcdCluster(3) as cluster:
        yield cluster.urls


@pytest.fixture(scope="module")
def three(store: str) -> Iterator[tuple[Router, Boards, Fleet]]:
    with fleet_of({"b01": (), "b02": (), "b03": ()}, store=store) as found:
        yield found


@pytest.fixture
def fleet(three: tuple[Router, Boards, Fleet]) -> Fleet:
    return three[2]


@pytest.fixture
def boards(three: tuple[Router, Boards, Fleet]) -> Boards:
    for board in three[1].values():
        if board.bridge.process is None:
            board.bridge.start()
    until(lambda: set(three[2].boards()) == set(three[1]))
    three[2].load("camera", "default")
    return three[1]


@pytest.fixture
def where(three: tuple[Router, Boards, Fleet], store: str, monkeypatch: pytest.MonkeyPatch) -> tuple[str, ...]:
    monkeypatch.setenv("LOGNAME", "anna")
    return "--router", three[0].endpoint, "--store", store


def state(fleet: Fleet, name: str) -> FleetState:
    until(lambda: name in fleet.boards())  # the network learns of a bridge a little after that is ready
    status = fleet.status([name])[name]
    assert isinstance(status, BoardStatus), status
    assert status.fleet is not None
    return status.fleet


def last_change(board: FleetBoard) -> int:
    with board.manager.connected() as client:
        return client.status.last_change


def without(fleet: Fleet, mode: str, away: set[str]) -> None:
    """Change all; those that are away are named, and the others are there."""
    with pytest.raises(ChangeFailed) as caught:
        fleet.mode(mode, absent="go-on")
    assert set(caught.value.course.differing) == away


# ---- 1: a board that was away -------------------------------------------------------------


def test_a_board_that_missed_two_changes_goes_to_the_newest_and_never_to_the_one_before(
    boards: Boards, fleet: Fleet
) -> None:
    b03 = boards["b03"]
    b03.bridge.end()
    until(lambda: "b03" not in fleet.boards())
    without(fleet, "colorise", {"b03"})
    without(fleet, "edge_detection", {"b03"})
    before = last_change(b03)
    b03.bridge.start()
    until(lambda: b03.place[1] == "edge_detection")
    until(lambda: state(fleet, "b03").state == "there")
    assert last_change(b03) == before + 1


def test_what_an_operator_did_while_the_bridge_was_away_stays_and_is_told(
    boards: Boards, fleet: Fleet, where: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    """The first finding, word for word: change 1 without b03, change 2 of the others, and `loopback` by hand."""
    b03 = boards["b03"]
    b03.bridge.end()
    until(lambda: "b03" not in fleet.boards())
    without(fleet, "colorise", {"b03"})
    fleet.mode("edge_detection", ["b01", "b02"])
    time.sleep(1.5)  # etcd's clock is told in whole seconds
    with b03.manager.connected() as client:
        client.mode = "loopback"
    b03.bridge.start()
    until(lambda: state(fleet, "b03").state == "drift")
    assert b03.place[1] == "loopback"
    assert main(["fleet", "status", *where]) == 1
    shown = capsys.readouterr().out
    assert "wanted camera/colorise" in shown
    assert "cm fleet reconcile b03" in shown
    assert state(fleet, "b01").state == state(fleet, "b02").state == "there"  # who is right is not blamed
    assert main(["fleet", "reconcile", "b03", *where]) == 0
    assert b03.place[1] == "colorise"


def test_what_is_wanted_after_an_operator_took_a_board_elsewhere_counts_also_if_its_bridge_was_away(
    boards: Boards, fleet: Fleet
) -> None:
    b03 = boards["b03"]
    b03.bridge.end()
    until(lambda: "b03" not in fleet.boards())
    with b03.manager.connected() as client:
        client.mode = "loopback"
    time.sleep(1.5)  # etcd's clock is told in whole seconds
    without(fleet, "edge_detection", {"b03"})
    b03.bridge.start()
    until(lambda: b03.place[1] == "edge_detection")
    until(lambda: state(fleet, "b03").state == "there")


def test_a_board_on_which_every_load_fails_is_told_and_repaired(boards: Boards, fleet: Fleet) -> None:
    boards["b02"].sim.control.inject("icap_crc", count=0)
    with pytest.raises(ChangeFailed, match=r"back in the mode before .*, but for b02: "):
        fleet.mode("colorise")
    assert state(fleet, "b02").state in ("failed", "going")
    boards["b02"].sim.control.clear("icap_crc")
    until(lambda: state(fleet, "b02").state == "there", 60.0)
    assert boards["b02"].place == ("camera", "default")


def test_a_local_change_is_drift_until_something_new_is_wanted(boards: Boards, fleet: Fleet) -> None:
    with boards["b02"].manager.connected() as client:
        client.mode = "colorise"
    until(lambda: state(fleet, "b02").state == "drift")
    fleet.mode("edge_detection")
    assert state(fleet, "b02").state == "there"


# ---- 2: clocks ------------------------------------------------------------------------------


@pytest.mark.parametrize("days", [-1, 1])
def test_a_board_whose_clock_is_a_day_off_is_free_as_soon_as_the_others_when_a_coordinator_dies(
    boards: Boards, fleet: Fleet, where: tuple[str, ...], tmp_path: Path, days: int
) -> None:
    b02 = boards["b02"]
    (tmp_path / "sitecustomize.py").write_text(CLOCK)
    b02.bridge.end()
    ahead = {"PYTHONPATH": f"{tmp_path}:{REPOSITORY}", "CM_TEST_AHEAD": str(days * 86400)}
    say = [sys.executable, "-c", "import time; print(time.time())"]
    shown = subprocess.run(say, env=environment(**ahead), check=True, capture_output=True).stdout
    assert abs(float(shown) - time.time() - days * 86400) < 600
    b02.bridge.start(**ahead)
    until(lambda: "b02" in fleet.boards())
    died_at("apply", where)
    until(lambda: all(not state(fleet, name).change for name in boards), ENDS + BUSY)
    assert {board.place[1] for board in boards.values()} == {"default"}
    fleet.mode("edge_detection")  # and takes part in the next
    b02.bridge.end()


# ---- 3: who is missing ----------------------------------------------------------------------


def test_a_change_of_all_is_refused_while_one_of_the_inventory_is_away_and_the_status_names_it(
    boards: Boards, fleet: Fleet, where: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    boards["b03"].bridge.end()
    until(lambda: "b03" not in fleet.boards())
    assert main(["fleet", "mode", "colorise", *where]) == 1
    assert "nothing was changed: b03: it is not in the fleet now" in capsys.readouterr().err
    assert {board.place[1] for board in boards.values()} == {"default"}
    assert main(["fleet", "mode", "colorise", "--absent", "go-on", *where]) == 1
    assert "the fleet is in the new mode, but for b03" in capsys.readouterr().err
    assert main(["fleet", "status", *where]) == 1
    assert "b03" in capsys.readouterr().out
    boards["b03"].bridge.start()
    until(lambda: boards["b03"].place[1] == "colorise")
    until(lambda: main(["fleet", "status", *where]) == 0)


def test_while_the_store_is_away_no_change_begins_and_everything_local_goes_on(
    boards: Boards, three: tuple[Router, Boards, Fleet], fleet: Fleet, store: str
) -> None:
    if store != "keeper":
        pytest.skip("a cluster has no single place")
    until(lambda: all(state(fleet, name).state == "there" for name in boards))
    boards["b01"].bridge.end()  # the keeper
    with pytest.raises(StoreAway, match="the fleet's keeper does not answer"):
        fleet.mode("colorise", ["b02"])
    with boards["b02"].manager.connected() as client:
        client.mode = "edge_detection"
    assert isinstance(fleet.write({"led": 5}, ["b03"])["b03"], RegValues)
    until(lambda: "does not answer" in state(fleet, "b02").store_error)
    boards["b01"].bridge.start()
    until(lambda: state(fleet, "b02").state == "drift")  # nothing is lost
    assert set(fleet.inventory()) == set(boards)


# ---- 4: a dead coordinator --------------------------------------------------------------------

CLIENT = """
import sys, time, cm.fleet

def tell(phase, *_):
    print(phase, flush=True)
    if phase == sys.argv[3]:
        time.sleep(3600)

cm.fleet.connect(sys.argv[1], store=sys.argv[2], caller="anna").mode("edge_detection", sys.argv[4:] or ["*"], tell=tell)
"""


def died_at(phase: str, where: tuple[str, ...], boards: tuple[str, ...] = ()) -> None:
    """A coordinator that is killed after the first answer of a phase."""
    command = [sys.executable, "-c", CLIENT, where[1], where[3], phase, *boards]
    with subprocess.Popen(command, stdout=subprocess.PIPE, env=environment(), cwd="/") as client:
        assert client.stdout is not None
        while (said := client.stdout.readline().decode().strip()) != phase:
            assert said, "the coordinator did not get so far"
        client.kill()


@pytest.mark.parametrize(
    ("phase", "mode"), [("prepare", "default"), ("apply", "default"), ("reconcile", "edge_detection")]
)
def test_a_coordinators_death_leaves_no_board_undecided_or_locked_longer_than_the_lease_and_5_s(
    boards: Boards, fleet: Fleet, where: tuple[str, ...], phase: str, mode: str
) -> None:
    died_at(phase, where)
    until(lambda: all(state(fleet, name).state == "there" for name in boards), ENDS + BUSY)
    assert {board.place[1] for board in boards.values()} == {mode}
    for board in boards.values():
        with board.manager.connected() as client:
            until(lambda: not client.status.leases)
            client.mode = "colorise"  # its local users are free


def test_two_boards_of_which_one_dies_with_its_coordinator_do_not_wait_for_ever(
    boards: Boards, fleet: Fleet, where: tuple[str, ...]
) -> None:
    died_at("apply", where, ("b02", "b03"))
    boards["b03"].bridge.end()
    until(lambda: not state(fleet, "b02").change, ENDS + BUSY)
    fleet.mode("colorise", ["b01", "b02"])
    boards["b03"].bridge.start()
    until(lambda: state(fleet, "b03").state == "there", ENDS + BUSY)
    assert boards["b03"].place[1] == "default"


@pytest.mark.parametrize("when", ["prepare", "apply"])
def test_while_the_router_is_away_nothing_is_said_that_is_not_known(
    boards: Boards, three: tuple[Router, Boards, Fleet], fleet: Fleet, when: str
) -> None:
    router = three[0]

    def tell(phase: str, board: str, answer: object) -> None:
        if phase == when:
            with contextlib.suppress(AssertionError):
                router.kill()

    said = ""
    try:
        fleet.mode("edge_detection", timeout=5.0, tell=tell)
    except (ChangeFailed, FleetRefused, StoreAway) as error:
        said = str(error)
    router.start()
    assert when == "prepare" or "nothing was changed" not in said
    until(lambda: set(fleet.boards()) == set(boards), 90.0)
    until(lambda: all(state(fleet, name).state == "there" for name in boards), ENDS + BUSY)
    wanted = {view.wanted.mode for view in fleet.inventory().values() if view.wanted}
    assert {board.place[1] for board in boards.values()} == wanted
    assert len(wanted) == 1


# ---- 5: registers -----------------------------------------------------------------------------


def test_a_change_that_is_taken_back_leaves_the_registers_as_they_were(boards: Boards, fleet: Fleet) -> None:
    fleet.write({"focus": 5, "zoom": 4})
    boards["b02"].sim.control.inject("icap_crc", count=1)
    with pytest.raises(ChangeFailed, match="back in the mode before"):
        fleet.mode("edge_detection")
    for board in boards.values():
        with board.manager.connected() as client:
            assert (client.registers["focus"], client.registers["zoom"]) == (5, 4)
            assert client.status.mode == "default"
