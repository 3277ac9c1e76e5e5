# SPDX-License-Identifier: Apache-2.0
"""Keys over TCP: who is admitted, in which role, and until when; with the blocking and the asyncio client."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import time
from collections.abc import Iterator
from datetime import datetime, timedelta, timezone
from pathlib import Path

import pytest
import zmq
from manager_process import CAMERA, Manager, short_folder, until

import cm
import cm.aio
from cm.cli.keygen import write_key_file
from cm.cli.main import main
from cm.client.stream import NewestStream
from cm.errors import CmError, Forbidden, InvalidRequest, Timeout
from cm.server.rights.keys import read_key_file
from cm.simulation.software import Board as SimBoard
from cm.wire.cm_pb2 import RegWrite, Reply, WriteReg
from cm.wire.topics import tcp_endpoints


class Guarded:
    """A manager with keys, run like a service but without a service manager."""

    def __init__(self, folder: Path, board: Path) -> None:
        self.folder, self.keys = folder, folder / "keys"
        self.key("owner", "provision")
        settings = folder / "cm.yaml"
        settings.write_text(
            f"listen: ['tcp://127.0.0.1:0']\nkeys: {self.keys}/server.key\nstate_dir: {folder}/state\nlog: warning\n"
            "access: {roles: {tuner: {role: operate, registers: [focus]}, clerk: {role: observe, topics: cm_status}, "
            "gateway: {role: operate, guests: 'web:*'}}, guests: {'web:eve': observe, 'web:ada': operate}}\n"
        )
        arguments = ("--settings", str(settings), "--config", str(CAMERA), "--root", str(board))
        self.manager = Manager(folder / "run", *arguments, service=True).start()
        with self.manager.connected() as board_:
            board_.load("camera", "default")

    def key(self, name: str, role: str, *more: str) -> Path:
        assert main(["keygen", str(self.keys), name, "--role", role, *more]) == 0
        return self.keys / f"{name}.key"

    def reload(self) -> None:
        assert self.manager.process is not None
        os.kill(self.manager.process.pid, signal.SIGHUP)

    @property
    def address(self) -> str:
        return self.manager.tcp()

    def connect(self, name: str) -> cm.Board:
        return cm.connect(self.address, keys=self.keys / f"{name}.key", timeout=60)

    def lets_in(self, name: str) -> bool:
        try:
            with self.connect(name) as board:
                return bool(board.configs)
        except Forbidden:
            return False


@pytest.fixture(scope="module")
def guarded() -> Iterator[Guarded]:
    with short_folder() as folder, SimBoard([CAMERA], root=folder / "board") as sim:
        made = Guarded(folder, sim.root)
        yield made
        made.manager.stop()


def problem(guarded: Guarded, keys: Path | None, timeout: float = 30) -> str:
    """The error of connecting with a key file, the same for both clients."""
    with pytest.raises(Forbidden) as caught, cm.connect(guarded.address, keys=keys, timeout=timeout) as board:
        board.configs  # noqa: B018
    assert caught.value.code == "forbidden"

    async def twin() -> str:
        with pytest.raises(Forbidden) as caught:
            async with cm.aio.connect(guarded.address, keys=keys, timeout=timeout) as board:
                await board.configs()
        return str(caught.value)

    assert asyncio.run(twin()) == str(caught.value)
    return str(caught.value)


def test_a_client_with_an_unknown_key_is_refused_and_not_left_waiting(guarded: Guarded) -> None:
    stranger = guarded.key("stranger", "admin")
    (guarded.keys / "authorized_keys.d/stranger.pub").unlink()
    assert "does not know this key" in problem(guarded, stranger)


def test_a_client_without_a_key_learns_that_it_needs_one(guarded: Guarded) -> None:
    assert "wants keys" in problem(guarded, None)


def test_a_client_with_another_boards_key_learns_so_when_its_time_runs_out(guarded: Guarded, tmp_path: Path) -> None:
    public, secret = zmq.curve_keypair()
    other = tmp_path / "other.key"
    write_key_file(other, {"server-public": zmq.curve_keypair()[0], "public": public, "secret": secret}, "client")
    for seconds in (1.0, 5.0, 60.0):  # three handshakes have to fail in that time
        with contextlib.suppress(Timeout):
            assert "another key than" in problem(guarded, other, timeout=seconds)
            break
    else:
        pytest.fail("it was never told")


def test_an_observer_looks_and_changes_nothing(guarded: Guarded) -> None:
    guarded.key("eyes", "observe")
    guarded.reload()
    until(lambda: guarded.lets_in("eyes"))
    with guarded.connect("eyes") as board:
        assert board.status.mode == "default"
        focus = board.registers["focus"]
        with pytest.raises(Forbidden, match=r"key eyes has no right to cm_write_reg.*role operate"):
            board.registers["focus"] = focus + 1
        with pytest.raises(Forbidden, match="role operate"):
            board.mode = "edge_detection"
        with pytest.raises(Forbidden, match="role operate"), board.lease("board"):
            pass
        assert board.registers["focus"] == focus
        assert board.status.mode == "default"


def test_a_narrow_role_reaches_its_registers_and_no_others(guarded: Guarded) -> None:
    guarded.key("tuner", "observe,tuner")
    until(lambda: guarded.lets_in("tuner"))
    with guarded.connect("tuner") as board:
        board.registers["focus"] = 3
        assert board.registers["focus"] == 3
        with pytest.raises(Forbidden, match="register 'zoom'"):
            board.registers["zoom"] = 2
        with pytest.raises(Forbidden, match="register 'zoom'"):
            board.registers.write({"focus": 1, "zoom": 2})
        assert board.registers["focus"] == 3  # all or nothing


def test_a_client_that_may_not_see_everything_asks_and_does_not_subscribe(guarded: Guarded) -> None:
    path = guarded.key("clerk", "clerk")
    until(lambda: _knows(guarded, "clerk"))
    with guarded.connect("clerk") as board:
        assert board.status.mode == "default"
        with pytest.raises(Forbidden, match="cm_read_reg"):
            board.registers["focus"]
        with pytest.raises(Forbidden, match="refuses subscriptions"), board.watch(timeout=30) as events:
            events.next()
        assert board.status.mode == "default"

    async def twin() -> None:
        async with cm.aio.connect(guarded.address, keys=path, timeout=30) as board:
            with pytest.raises(Forbidden, match="refuses subscriptions"):
                async with board.watch(timeout=30) as events:
                    await events.next()

    asyncio.run(twin())


def _knows(guarded: Guarded, name: str) -> bool:
    try:
        with guarded.connect(name) as board:
            return bool(board.status.mode)
    except Forbidden:
        return False


def test_a_bridge_asks_in_the_name_of_its_guests_with_their_rights(guarded: Guarded) -> None:
    path = guarded.key("gateway", "gateway")
    until(lambda: guarded.lets_in("gateway"))
    keys = read_key_file(path)
    request = WriteReg(writes=[RegWrite(name="focus", value=5)]).SerializeToString()
    with zmq.Context() as context, context.socket(zmq.DEALER) as bridge:
        bridge.linger = 0
        bridge.curve_serverkey, bridge.curve_publickey = keys["server-public"], keys["public"]
        bridge.curve_secretkey = keys["secret"]
        bridge.connect(tcp_endpoints(guarded.address).req)

        def told(*envelope: bytes) -> Reply:
            bridge.send_multipart([b"1", *envelope, b"", b"cm_write_reg", request])
            assert bridge.poll(60_000)
            frames = bridge.recv_multipart()
            assert frames[: len(envelope) + 2] == [b"1", *envelope, b""]
            return Reply.FromString(frames[-1])

        assert told().ok
        assert told(b"for=web:ada").ok
        refused = told(b"for=web:eve").error
        assert (refused.code, refused.message.startswith("web:eve through curve:")) == ("forbidden", True)
        assert told(b"for=root").error.code == "forbidden"
        assert told(b"for=").error.code == "forbidden"


def test_both_clients_ask_in_the_name_of_a_guest(guarded: Guarded) -> None:
    path = guarded.key("bridge", "gateway")
    until(lambda: guarded.lets_in("bridge"))

    def connect(guest: str) -> cm.Board:
        return cm.connect(guarded.address, keys=path, timeout=60, guest=guest)

    with connect("web:ada") as ada, connect("web:eve") as eve:
        ada.registers["focus"] = 4
        assert eve.registers["focus"] == 4
        with pytest.raises(Forbidden, match=r"web:eve through curve:.* has no right to cm_write_reg"):
            eve.registers["focus"] = 5
        assert [ada.load("camera", "default") >= 0, ada.load_async("camera", "default").wait(30) >= 0] == [True, True]
        with ada.stream("camera", timeout=30) as frames:
            assert frames.read().shape == frames.read().shape
        with ada.lease("config", seconds=30):
            assert [lease.holder for lease in ada.status.leases] == ["web:ada"]
        with pytest.raises(InvalidRequest, match="handed to the bridge, not to 'web:ada'"):
            ada.watch()
    with pytest.raises(Forbidden, match="has no right to cm_status"):
        connect("root")
    with pytest.raises(InvalidRequest, match="64 characters"):
        connect("x" * 65)

    async def twin() -> None:
        async with cm.aio.connect(guarded.address, keys=path, timeout=60, guest="web:eve") as eve:
            assert "focus" in await eve.registers.read("focus")
            with pytest.raises(Forbidden, match="web:eve through curve"):
                await eve.registers.write({"focus": 5})
            with pytest.raises(InvalidRequest, match="handed to the bridge"):
                eve.watch()
            async with eve.stream("camera", timeout=30) as frames:
                assert (await frames.read()).shape

    asyncio.run(twin())


def test_a_bridge_on_the_managers_machine_opens_no_data_socket_for_a_guest(guarded: Guarded) -> None:
    """That would be with the bridge's own rights."""
    with cm.connect(runtime_dir=guarded.manager.runtime, timeout=60, guest="web:ada") as ada:
        assert ada.status.mode == "default"
        with ada.stream("camera", timeout=30) as frames:
            assert isinstance(frames, NewestStream)
            assert frames.read().shape
        with pytest.raises(InvalidRequest, match="knows no guests"):
            ada.allocate(16)


def test_a_key_that_is_taken_away_ends_its_sessions_while_others_go_on(guarded: Guarded) -> None:
    guarded.key("leaver", "provision")
    guarded.reload()
    until(lambda: guarded.lets_in("leaver"))
    with guarded.connect("leaver") as leaver, guarded.connect("owner") as owner:
        assert leaver.status.mode == owner.status.mode
        (guarded.keys / "authorized_keys.d/leaver.pub").unlink()
        guarded.reload()
        until(lambda: _refused(leaver))
        until(lambda: not _refused(owner))
    assert not guarded.lets_in("leaver")


def _refused(board: cm.Board) -> bool:
    try:
        return not board.configs
    except Forbidden:
        return True
    except CmError:
        return False


def test_a_key_ends_at_its_time_with_its_sessions(guarded: Guarded) -> None:
    guarded.key("guest", "observe")
    until(lambda: guarded.lets_in("guest"))
    with guarded.connect("guest") as board:
        assert board.configs
        end = datetime.now(timezone.utc) + timedelta(seconds=2)
        with (guarded.keys / "authorized_keys.d/guest.pub").open("a") as file:
            file.write(f"expires: {end.isoformat()}\n")
        until(lambda: _refused(board), timeout=60)
        assert time.time() >= end.timestamp()
    assert not guarded.lets_in("guest")


def test_the_log_names_once_who_did_what_and_who_was_refused(guarded: Guarded) -> None:
    guarded.key("writer", "operate")
    until(lambda: guarded.lets_in("writer"))
    with guarded.connect("writer") as board:
        for value in range(20):
            board.registers["focus"] = value % 8
        for _ in range(5):
            with pytest.raises(Forbidden):
                board.provision(CAMERA / "camera.yaml")
    guarded.manager.stop()
    log = guarded.manager.log.decode()
    assert log.count("key writer: WriteReg focus") == 1
    assert log.count("refused: key writer has no right to cm_write_config; it takes the role provision") == 1
    assert "is not let in" in log
    guarded.manager.start()
