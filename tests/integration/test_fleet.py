# SPDX-License-Identifier: Apache-2.0
"""A fleet of simulated boards over zenoh: shipped managers and bridges, a router, a client."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import runpy
import select
import signal
import socket
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import zenoh
from fleet_support import EDGE, VISION, FleetBoard, Router, fleet_of
from manager_process import REPOSITORY, Manager, environment, until
from web_support import chromium, page_of, web_server

import cm.fleet
from cm import child
from cm.cli.main import main
from cm.networks.fleet.blocking import Fleet
from cm.networks.fleet.errors import ChangeFailed, FleetRefused, NoSuchBoard
from cm.networks.fleet.store import StoreAway
from cm.networks.fleet.zenoh_session import Network, session
from cm.tools.demo.boards import free_ports
from cm.wire import cm_pb2 as pb
from cm.wire.messages.fleet import BoardStatus, BundleState, Decision
from cm.wire.messages.status import ErrorInfo, RegValues

pytestmark = pytest.mark.networks

Boards = dict[str, FleetBoard]


@pytest.fixture(scope="module")
def places(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folders where boards put imported archives."""
    return tmp_path_factory.mktemp("imported")


@pytest.fixture(scope="module")
def three(places: Path) -> Iterator[tuple[Router, Boards, Fleet]]:
    """b1 accepts archives, b2 only signed ones, c3 none; anna may provision."""
    (places / "signers").mkdir()
    strict = places / "strict.yaml"
    strict.write_text(json.dumps({"policy": {"signatures": "require", "signers": str(places / "signers")}}))
    options = {
        "b1": ("--label", "north", "--import-to", str(places / "b1")),
        "b2": ("--import-to", str(places / "b2"), "--settings", str(strict)),
        "c3": ("--label", "north"),
    }
    with fleet_of(options, '{"zenoh:anna": provision, "*": operate}') as found:
        yield found


@pytest.fixture
def fleet(three: tuple[Router, Boards, Fleet]) -> Fleet:
    return three[2]


@pytest.fixture
def boards(three: tuple[Router, Boards, Fleet]) -> Boards:
    """All three in their default mode, and wanted there."""
    until(lambda: set(three[2].boards()) == set(three[1]))
    three[2].load("camera", "default")
    return three[1]


def modes(boards: Boards) -> set[str]:
    return {board.place[1] for board in boards.values()}


# ---- looking ------------------------------------------------------------------------------


def test_boards_are_found_and_grouped_by_name_and_label(fleet: Fleet) -> None:
    assert fleet.boards() == ("b1", "b2", "c3")
    assert fleet.chosen(["b*"]) == ("b1", "b2")
    assert fleet.chosen(["@north"]) == ("b1", "c3")
    assert fleet.chosen(["@north", "b2"]) == ("b1", "b2", "c3")
    with pytest.raises(NoSuchBoard, match="no board of the inventory is called or labelled x1; it has b1, b2, c3"):
        fleet.chosen(["x1"])


def test_a_store_that_takes_connections_and_says_nothing_is_waited_for_as_long_as_was_asked(fleet: Fleet) -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        where = f"http://127.0.0.1:{silent.getsockname()[1]}"
        answered = pytest.raises(StoreAway, match=r"did not answer within 0\.5 s")
        with cm.fleet.connect(_endpoint(fleet), store=where, timeout=0.5) as hasty, answered:
            hasty.inventory()


def test_the_status_has_what_the_manager_says_and_what_the_bridge_knows(boards: Boards, fleet: Fleet) -> None:
    found = fleet.status()
    assert list(found) == ["b1", "b2", "c3"]
    status = found["b1"]
    assert isinstance(status, BoardStatus)
    assert (status.status.board, status.status.mode, status.labels) == ("b1", "default", ("north",))


def test_a_bridge_that_hangs_is_distinguished_from_a_board_that_is_gone(boards: Boards, fleet: Fleet) -> None:
    boards["b2"].bridge.send(signal.SIGSTOP)
    try:
        with cm.fleet.connect(_endpoint(fleet), caller="anna", timeout=5.0) as hasty:
            found = hasty.status(["b2", "x9"])
    finally:
        boards["b2"].bridge.send(signal.SIGCONT)
    hangs, absent = found["b2"], found["x9"]
    assert isinstance(hangs, ErrorInfo)
    assert isinstance(absent, ErrorInfo)
    assert "is in the fleet but did not answer" in hangs.message
    assert "is not in the fleet" in absent.message


def _endpoint(fleet: Fleet) -> tuple[str, ...]:
    return fleet._fleet._network.connect


def test_registers_of_all_boards_are_written_and_read_and_errors_have_their_board(boards: Boards, fleet: Fleet) -> None:
    assert set(fleet.write({"led": 3}, ["b1", "b2"])) == {"b1", "b2"}
    found = fleet.read("led", "b1")["b1"]  # a single one stands alone
    assert isinstance(found, RegValues)
    assert found.values[0].value == 3
    wrong = fleet.read("nix")
    assert {n: e.code for n, e in wrong.items() if isinstance(e, ErrorInfo)} == dict.fromkeys(
        boards, "unknown_register"
    )


def test_the_caller_is_in_the_managers_log_and_holds_its_leases(boards: Boards, fleet: Fleet) -> None:
    manager, holders = boards["b1"].manager, []

    def tell(phase: str, board: str, answer: object) -> None:
        if phase == "prepare" and board == "b1":
            with manager.connected() as client:
                holders.extend(lease.holder.rpartition(" ")[2] for lease in client.status.leases)

    fleet.mode("edge_detection", ["b1"], tell=tell)
    assert holders == ["anna"]
    until(lambda: b"zenoh:anna through" in _more_of_the_log(manager))


def _more_of_the_log(manager: Manager) -> bytes:
    assert manager.process is not None
    assert manager.process.stderr is not None
    if select.select([manager.process.stderr], [], [], 0)[0]:
        manager.log += os.read(manager.process.stderr.fileno(), 65536)
    return manager.log


def test_watching_tells_changes_and_boards_that_come_and_go(boards: Boards, fleet: Fleet) -> None:
    with fleet.watch() as statuses:
        seen: set[str] = set()
        while seen != set(boards):
            seen.add(next(statuses)[0])
        with boards["c3"].manager.connected() as client:
            client.mode = "edge_detection"  # by hand, which stays
        assert _until(statuses, "c3", lambda s: s is not None and s.status.mode == "edge_detection")
        with fleet.watch("b1") as own:
            boards["c3"].bridge.end()
            assert _until(statuses, "c3", lambda s: s is None)
            assert {next(own)[0] for _ in range(4)} == {"b1"}  # which is told of nobody else
        boards["c3"].bridge.start()
        assert _until(statuses, "c3", lambda s: s is not None)


def _until(statuses: Iterator[tuple[str, BoardStatus | None]], board: str, wanted: object) -> bool:
    return any(name == board and wanted(status) for name, status in statuses)  # type: ignore[operator]


def test_a_board_whose_manager_is_down_is_told_to_be_gone(
    boards: Boards, fleet: Fleet, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cm.networks.fleet.presence._SILENCE", 2.0)
    with fleet.watch("c3") as statuses:
        next(each for each in statuses if each[1] is not None)
        boards["c3"].manager.stop()
        try:
            assert next(each for each in statuses if each[1] is None) == ("c3", None)
        finally:
            boards["c3"].manager.start()
        assert next(each for each in statuses if each[1] is not None)[0] == "c3"


def test_a_stream_runs_only_while_there_is_a_listener(boards: Boards, three: tuple[Router, Boards, Fleet]) -> None:
    with session(Network(connect=(three[0].endpoint,))) as plain, boards["b1"].manager.connected() as client:
        assert not client.status.streams[0].open
        frames = plain.declare_subscriber("cm/b1/frames/camera", zenoh.handlers.FifoChannel(8))
        frame = frames.recv()
        assert frame.attachment is not None
        assert len(bytes(frame.payload)) == 640 * 480
        frames.undeclare()
        until(lambda: not client.status.streams[0].open)


# ---- changing -----------------------------------------------------------------------------


def test_all_boards_change_together_and_the_critical_path_is_reported(boards: Boards, fleet: Fleet) -> None:
    course = fleet.mode("edge_detection")
    assert course.decision is Decision.KEEP
    assert [leg.phase for leg in course.legs] == ["open", "prepare", "apply", "decide", "reconcile"]
    assert modes(boards) == {"edge_detection"}
    with boards["b1"].manager.connected() as client:
        assert not client.status.leases  # it was given back


def test_a_mode_that_one_board_does_not_know_changes_nothing_anywhere(boards: Boards, fleet: Fleet) -> None:
    with pytest.raises(
        FleetRefused, match=r"nothing was changed: b1, b2, c3: configuration 'camera' has no mode 'nix'"
    ):
        fleet.mode("nix")
    assert modes(boards) == {"default"}


def test_another_clients_lease_on_one_board_refuses_the_change_by_name(boards: Boards, fleet: Fleet) -> None:
    refused = pytest.raises(FleetRefused, match=r"nothing was changed: c3: .*carl")
    with boards["c3"].manager.connected() as client, client.lease("board", holder="carl"), refused:
        fleet.mode("edge_detection")
    assert modes(boards) == {"default"}


def test_a_load_that_fails_on_one_board_takes_all_back(boards: Boards, fleet: Fleet) -> None:
    boards["b2"].sim.control.inject("icap_crc", count=1)
    with pytest.raises(ChangeFailed, match=r"back in the mode before .b2: "):
        fleet.mode("edge_detection")
    assert modes(boards) == {"default"}


def test_with_a_quorum_the_fleet_goes_on_and_names_the_board_that_failed(boards: Boards, fleet: Fleet) -> None:
    control = boards["b2"].sim.control
    control.inject("icap_crc", count=1)

    def tell(phase: str, board: str, answer: object) -> None:
        if (phase, board) == ("apply", "b2"):
            control.inject("icap_crc", count=1)  # and the board's own try to get there after the decision

    with pytest.raises(ChangeFailed) as caught:
        fleet.mode("edge_detection", policy="quorum", tell=tell)
    assert caught.value.course.decision is Decision.KEEP
    assert set(caught.value.course.differing) == {"b2"}
    assert {name: board.place[1] for name, board in boards.items()} == {
        "b1": "edge_detection", "b2": "default", "c3": "edge_detection",
    }  # fmt: skip
    until(lambda: modes(boards) == {"edge_detection"})  # it tries again by itself


def test_the_commands_show_a_fleet_and_change_it(
    boards: Boards, fleet: Fleet, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    router = ("--router", *_endpoint(fleet))
    monkeypatch.setenv("LOGNAME", "bob")
    assert main(["fleet", "ls", *router]) == 0
    assert [line.split()[:2] for line in capsys.readouterr().out.splitlines()[1:]] == [[n, "there"] for n in boards]
    assert main(["fleet", "plan", "edge_detection", "@north", *router]) == 0
    assert "camera/edge_detection" in capsys.readouterr().out
    assert main(["fleet", "mode", "camera/edge_detection", "b1", "b2", *router]) == 0
    assert "there" in capsys.readouterr().out
    assert main(["fleet", "status", "--json", *router]) == 0
    found = json.loads(capsys.readouterr().out)
    assert [found[name]["status"]["mode"] for name in found] == ["edge_detection", "edge_detection", "default"]
    assert found["b1"]["fleet"]["wanted_by"] == "bob"
    assert main(["fleet", "status", *router]) == 0
    assert "there" in capsys.readouterr().out
    for write in "led=0x2", "led.blink=3":
        assert main(["fleet", "reg", "write", write, "b1", *router]) == 0
        assert len(capsys.readouterr().out.splitlines()) == 2  # of that board alone
    assert main(["fleet", "reg", "read", "led.blink", "b1", *router]) == 0
    assert "0x3" in capsys.readouterr().out
    assert main(["fleet", "load", "camera/default", "b1", *router]) == 0
    assert len(capsys.readouterr().out.splitlines()) == 3
    assert main(["fleet", "mode", "nix", *router]) == 1


@pytest.mark.parametrize(
    ("words", "said"),
    [(("status", "a//b"), "must not have /"), (("remove",), "no board is named"), (("add", ""), "printable")],
)
def test_what_no_board_can_be_called_is_refused_in_words(
    words: tuple[str, ...], said: str, boards: Boards, fleet: Fleet, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["fleet", *words, "--router", *_endpoint(fleet)]) == 1
    assert said in capsys.readouterr().err
    assert set(fleet.inventory()) == set(boards)


def test_the_examples_of_the_reference_run(
    boards: Boards, fleet: Fleet, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("CM_FLEET", ",".join(_endpoint(fleet)))
    for name in ("fleet.py", "fleet_asyncio.py"):
        runpy.run_path(str(REPOSITORY / "docs/examples" / name), run_name="__main__")
    said = capsys.readouterr().out
    assert "\n3 boards in " in said
    assert "b1 (480, 640)" in said
    assert "c3 default" in said


# ---- ends ---------------------------------------------------------------------------------


def test_a_bridge_killed_during_a_change_comes_back_to_the_fleets_mode(boards: Boards, fleet: Fleet) -> None:
    """It had prepared, and received nothing of the rest; the other boards are enough."""
    killed = threading.Event()

    def tell(phase: str, board: str, answer: object) -> None:
        if phase == "prepare" and board == "c3":
            boards["c3"].bridge.end()
            killed.set()

    with pytest.raises(ChangeFailed) as caught:
        fleet.mode("edge_detection", policy="quorum", timeout=30.0, tell=tell)
    assert killed.is_set()
    assert set(caught.value.course.differing) == {"c3"}
    boards["c3"].bridge.start()
    until(lambda: modes(boards) == {"edge_detection"}, 60.0)


@pytest.mark.parametrize(("who", "phase"), [("manager", "prepare"), ("manager", "apply"), ("bridge", "apply")])
def test_whichever_process_is_killed_on_one_board_all_end_in_one_mode(
    boards: Boards, fleet: Fleet, who: str, phase: str
) -> None:
    victim = boards["b2"]
    killed: list[str] = []

    def tell(now: str, board: str, answer: object) -> None:
        if now == phase and board == "b2" and not killed:
            killed.append(board)
            if who == "bridge":
                victim.bridge.end()
                victim.bridge.start()
            else:
                victim.manager.kill()
                victim.manager.start()

    with contextlib.suppress(ChangeFailed):
        fleet.mode("edge_detection", timeout=20.0, tell=tell)
    assert killed
    until(lambda: all(_is_free(status) for status in fleet.status().values()), 60.0)
    assert len(modes(boards)) == 1


def _is_free(status: BoardStatus | ErrorInfo) -> bool:
    return isinstance(status, BoardStatus) and status.fleet is not None and status.fleet.state == "there"


def test_a_bridge_waits_for_its_router_and_ends_when_it_is_told_to(boards: Boards, tmp_path: Path) -> None:
    nowhere = {"endpoints": [f"tcp/127.0.0.1:{free_ports()}"], "timeout_ms": 100}
    (tmp_path / "fleet.json5").write_text(json.dumps({"mode": "client", "connect": nowhere}))
    where = ("--runtime-dir", str(boards["b1"].manager.runtime), "--zenoh-config", str(tmp_path / "fleet.json5"))
    command = child.command("cm.cli.main", "bridge", "fleet", *where)
    with subprocess.Popen(command, stderr=subprocess.PIPE, env=environment(), cwd="/") as bridge:
        there, said = child.said_until(bridge, b"it is tried again", 60.0)
        assert there, said
        bridge.terminate()
        assert bridge.wait(timeout=60) == 0


def test_a_second_bridge_of_one_name_is_refused(boards: Boards, three: tuple[Router, Boards, Fleet]) -> None:
    where = ("--runtime-dir", str(boards["b1"].manager.runtime), "--router", three[0].endpoint)
    command = child.command("cm.cli.main", "bridge", "fleet", "--name", "b1", "--lease", "1", *where)
    done = subprocess.run(command, capture_output=True, text=True, env=environment(), cwd="/", check=False, timeout=90)
    assert done.returncode == 1
    assert "a board called 'b1' is in this fleet already: give this one another --name" in done.stderr


# ---- archives ---------------------------------------------------------------------------


def test_boards_put_an_archive_in_force_as_their_policy_lets_them(
    boards: Boards,
    fleet: Fleet,
    places: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("LOGNAME", "anna")
    packed = tmp_path / "vision.tar.gz"
    packed.write_bytes(VISION)
    found = fleet.push(packed)
    first, second, third = found["b1"], found["b2"], found["c3"]
    assert isinstance(first, BundleState)
    assert (first.config_name, first.error) == ("vision", None)
    assert (places / "b1" / "vision" / "edge.bin").read_bytes() == EDGE
    assert isinstance(second, BundleState)
    assert second.error is not None
    assert "not signed" in second.error.message
    assert not (places / "b2" / "vision").exists()
    assert isinstance(third, ErrorInfo)
    assert "start it with --import-to DIR" in third.message
    with cm.fleet.connect(_endpoint(fleet), caller="bob", timeout=30.0) as other:
        refused = other.push(packed, ["b1"])["b1"]
    assert isinstance(refused, ErrorInfo)
    assert refused.code == "forbidden"
    assert main(["fleet", "push", str(packed), "b1", "--router", *_endpoint(fleet)]) == 0
    assert "vision" in capsys.readouterr().out


MINI = """
config:
  name: mini
  modules:
    edge: {bitstream: edge.bit, region: prr0}
  regions: {prr0: {decoupler: {base_address: 0x1000, offset: 0x0, bit: 0}}}
  modes:
    contours: {modules: [edge]}
"""


def test_a_configuration_is_sent_in_parts_by_any_client_and_loaded(
    boards: Boards, three: tuple[Router, Boards, Fleet]
) -> None:
    """With zenoh and the messages of cm.proto only."""
    board = boards["c3"]
    with session(Network(connect=(three[0].endpoint,))) as plain:

        def done(verb: str, message: Any, data: bytes | None = None) -> Any:
            sent = message.SerializeToString()
            beside = {} if data is None else {"attachment": sent}
            (reply,) = plain.get(f"cm/c3/do/{verb}/anna", payload=sent if data is None else data, timeout=60, **beside)
            found = pb.Reply.FromString(bytes(reply.ok.payload))
            assert found.ok, found.error
            return found

        bitstream = next(board.sim.root.rglob("edge.bit")).read_bytes()
        for offset in range(0, len(bitstream), 100_000):
            part = bitstream[offset : offset + 100_000]
            upload = pb.Upload(id="edge", length=len(bitstream), offset=offset)
            assert done("upload", upload, part).upload.offset == offset + len(part)
        sha256 = hashlib.sha256(bitstream).hexdigest()
        file = pb.File(name="edge.bit", length=len(bitstream), sha256=sha256, upload="edge")
        done("provision", pb.WriteConfig(schema=MINI, files=[file], provision_only=True))
        done("mode", pb.WriteConfig(config_name="mini", mode="contours"))
        assert board.place == ("mini", "contours")


# ---- the page -----------------------------------------------------------------------------


@pytest.mark.timeout(300)  # a browser, each of whose waits may last a minute on a busy machine
def test_the_page_shows_the_boards_of_the_fleet(
    boards: Boards, three: tuple[Router, Boards, Fleet], tmp_path: Path
) -> None:
    """In a browser, beside the board that the page belongs to."""
    router = ("--router", three[0].endpoint)
    with (
        web_server(boards["b1"].manager.runtime, *router) as server,
        chromium() as browser,
        page_of(browser, server) as page,
    ):
        for name in boards:
            page.wait_for_selector(f"[data-fleet-board={name}] .pill[data-state=idle]")
        assert "3 of 3 are there" in page.text_content("#fleet-about")
        assert "north" in page.text_content("[data-fleet-board=c3]")
        three[2].mode("edge_detection", ["c3"])
        page.wait_for_selector("[data-fleet-board=c3] >> text=camera / edge_detection")
        with boards["b2"].manager.connected() as client:
            client.mode = "colorise"
        page.wait_for_selector("[data-fleet-board=b2] >> text=differs")
        assert "wanted camera/default since generation" in page.text_content("[data-fleet-board=b2]")
        assert "camera / colorise (wanted: camera / default)" in page.text_content("[data-fleet-board=b2]")
        boards["c3"].bridge.end()
        page.wait_for_selector("[data-fleet-board=c3] >> text=gone")
        about = page.text_content("#fleet-about")
        assert "2 of 3 are there. Gone: c3. Elsewhere than wanted: b2." in about
        page.locator("#fleet").screenshot(path=tmp_path / "fleet.png")
        page.screenshot(path=tmp_path / "page.png", full_page=True)
    boards["c3"].bridge.start()
