# SPDX-License-Identifier: Apache-2.0
"""Who may do what, tried by processes of several users (as root; skipped otherwise)."""

from __future__ import annotations

import json
import os
import stat
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from manager_process import CAMERA, REPOSITORY, Manager, environment, short_folder, until

import cm
from cm.errors import CmError
from cm.server.requests import ROWS
from cm.server.rights.model import Role
from cm.server.rights.required_rights import OPENING
from cm.simulation.software import Board as SimBoard
from cm.wire import plane_packets as packets

needs_root = pytest.mark.skipif(os.geteuid() != 0, reason="needs root, to be several users")
GROUP, ALICE, BOB, CARL, DORA, ERIN, MALLORY, FRED, GINA, HUGO = range(47110, 47120)


# What was imported before may lie in a folder that this user cannot read.
USER = """
import encodings.idna, hashlib, json, os, queue, socket, sys
import cm, cm.aio, cm.client.board, cm.client.data_connection, cm.client.stream, cm.client.aio.stream
import cm.client.register_window, numpy.linalg
from cm.client.core.calls import Call
from cm.client.errors import WindowRevoked
from cm.errors import CmError
from cm.wire import plane_packets as p
from cm.wire.messages import requests as rq

uid, groups, runtime, *more = json.loads(sys.argv[1])
os.setgroups(groups); os.setgid(uid); os.setuid(uid)
"""


def as_user(
    script: str, manager: Manager, uid: int, *more: str, groups: tuple[int, ...] = (GROUP,)
) -> subprocess.Popen[str]:
    """A program that a user with these groups runs; what it prints can be read."""
    command = [sys.executable, "-c", USER + script, json.dumps([uid, groups, str(manager.runtime), *more])]
    return subprocess.Popen(command, env=environment(), stdout=subprocess.PIPE, text=True, cwd=REPOSITORY)


def ended(program: subprocess.Popen[str]) -> str:
    """What it has printed, when it has ended well."""
    said, _ = program.communicate(timeout=60)
    assert program.returncode == 0
    return said


PLAY = """
def tried(act):
    try:
        return str(act())
    except (CmError, OSError) as error:
        return f"{type(error).__name__}: {getattr(error, 'code', '')}: {error}"

def write(name, value):
    board.registers[name] = value

try:
    with cm.connect(runtime_dir=runtime, timeout=60) as board:
        result = {act: tried(eval("lambda: " + act)) for act in more}
except (CmError, OSError) as error:
    result = {"connect": f"{type(error).__name__}: {getattr(error, 'code', '')}: {error}"}
print(json.dumps(result))
"""


def outcome(manager: Manager, uid: int, *acts: str, groups: tuple[int, ...] = (GROUP,)) -> dict[str, str]:
    """The outcome of a user's actions, with these groups; or of its attempt to connect."""
    found: dict[str, str] = json.loads(ended(as_user(PLAY, manager, uid, *acts, groups=groups)))
    return found


@pytest.fixture(scope="module")
def manager() -> Iterator[Manager]:
    """A manager whose sockets belong to a group, and that knows all but one of the group's members."""
    with short_folder() as folder, SimBoard([CAMERA], root=folder / "board") as sim:
        folder.chmod(0o755)
        settings = folder / "cm.yaml"
        users = (
            f"{ALICE}: operate, {BOB}: observe, {CARL}: provision, {DORA}: provision, {ERIN}: [operate], "
            f"{FRED}: [map], {GINA}: [observe], {HUGO}: lamp"
        )
        roles = "{lamp: {role: observe, registers: [led]}}"
        settings.write_text(
            f"state_dir: {folder}/state\naccess: {{group: '{GROUP}', local: [], users: {{{users}}}, roles: {roles}}}\n"
        )
        arguments = ("--settings", str(settings), "--config", str(CAMERA), "--root", str(sim.root))
        manager = Manager(folder / "run", *arguments, service=True)
        manager.start()
        with manager.connected() as board:
            board.load("camera", "default")
        try:
            yield manager
        finally:
            manager.stop()


@pytest.mark.programs
@needs_root
def test_only_the_group_can_open_the_sockets(manager: Manager) -> None:
    for name in ("pub", "sub", "req", "data"):
        status = (manager.runtime / name).stat()
        assert (status.st_gid, stat.S_IMODE(status.st_mode)) == (GROUP, 0o660), name
    assert stat.S_IMODE(manager.runtime.stat().st_mode) == 0o750


@pytest.mark.programs
@needs_root
def test_two_users_of_different_roles_and_one_without(manager: Manager) -> None:
    acts = ("board.status.mode", "board.registers['focus']", "write('focus', 2)")
    assert outcome(manager, ALICE, *acts) == {acts[0]: "default", acts[1]: "1", acts[2]: "None"}
    seen = outcome(manager, BOB, *acts)
    assert (seen[acts[0]], seen[acts[1]]) == ("default", "2")
    assert seen[acts[2]].startswith("RequestForbidden: forbidden: ")
    assert "takes the role operate" in seen[acts[2]]
    told = outcome(manager, MALLORY, "board.status")["connect"]
    assert told.startswith("NotAdmitted: forbidden: the manager at ipc://")
    assert "gives this user no role" in told


@pytest.mark.programs
@needs_root
def test_a_user_outside_the_group_learns_the_reason_at_once(manager: Manager) -> None:
    told = outcome(manager, ALICE, "board.status", groups=())["connect"]
    assert told.startswith("NotAdmitted: forbidden: this user may not use the sockets in ")
    assert f"members of {GROUP}" in told or "members of its group" in told


HOLD = """
board = cm.connect(runtime_dir=runtime, timeout=60)
frames = iter(board.stream("camera", timeout=60))
events = board.watch(timeout=60)
next(frames)
print("ready", flush=True)
try:
    while True:
        next(frames)
except (CmError, OSError) as error:
    print(type(error).__name__, flush=True)
try:
    while True:
        events.next()
except (CmError, OSError) as error:
    print(type(error).__name__, flush=True)
try:
    board.status
except (CmError, OSError) as error:
    print(type(error).__name__, getattr(error, "code", ""), flush=True)
os._exit(0)
"""


@pytest.mark.programs
@needs_root
def test_a_user_whose_role_is_taken_away_loses_streams_subscriptions_and_requests(manager: Manager) -> None:
    """Others notice nothing."""
    settings = manager.runtime.parent / "cm.yaml"
    with (
        as_user(HOLD, manager, ERIN) as held,
        manager.connected() as board,
        board.stream("camera", timeout=60) as stream,
    ):
        assert held.stdout is not None
        assert held.stdout.readline() == "ready\n"
        next(iter(stream))
        settings.write_text(settings.read_text().replace("[operate]", "[]"))
        assert held.stdout.read().split("\n")[:3] == ["ConnectionLost", "NotAdmitted", "NotAdmitted forbidden"]
        next(iter(stream))
        assert board.status.mode == "default"


MOVING = """
config:
  name: moving
  type: partial
  regions:
    prr0: {decoupler: {base_address: 0x1000, offset: 0, bit: 0}}
    prr1: {decoupler: {base_address: 0x1000, offset: 0, bit: 1}}
  modules:
    default: {region: prr0}
    other: {region: prr1}
  streams:
    camera: {direction: s2mm, shape: [48, 64], rate: 100, region: prr0}
  modes:
    near: {modules: [default, other]}
    far: {modules: [default, other], streams: {camera: {region: prr1}}}
"""

LOOK = """
board = cm.connect(runtime_dir=runtime, timeout=60)
for _ in range(2):
    try:
        frames = iter(board.stream("camera", timeout=60))
        next(frames)
        print("ready", flush=True)
        while True:
            next(frames)
    except (CmError, OSError) as error:
        print(type(error).__name__, error, flush=True)
os._exit(0)
"""


@pytest.mark.programs
@needs_root
def test_who_may_read_in_one_region_does_not_follow_a_stream_into_another() -> None:
    """Whose right reaches there goes on, and so does the user with the limit where a change leaves the stream there."""
    with short_folder() as folder:
        folder.chmod(0o755)
        (folder / "moving.yaml").write_text(MOVING)
        with SimBoard([folder / "moving.yaml"], root=folder / "board") as sim:
            settings = folder / "cm.yaml"
            settings.write_text(
                f"state_dir: {folder}/state\naccess: {{group: '{GROUP}', local: [], "
                f"users: {{{ALICE}: eye}}, roles: {{eye: {{role: observe, regions: [prr0]}}}}}}\n"
            )
            arguments = ("--settings", str(settings), "--config", str(folder / "moving.yaml"), "--root", str(sim.root))
            manager = Manager(folder / "run", *arguments, service=True)
            manager.start()
            try:
                with manager.connected() as board:
                    board.load("moving", "near")
                    with as_user(LOOK, manager, ALICE) as looks, board.stream("camera", timeout=60) as stream:
                        assert looks.stdout is not None
                        assert looks.stdout.readline() == "ready\n"
                        board.load("moving", "near")
                        next(iter(stream))
                        assert looks.poll() is None
                        board.set_mode("far")
                        lost, refused = looks.stdout.read().splitlines()
                        assert lost.startswith("ConnectionLost ")
                        assert "has no right to data on configuration 'moving', region 'prr1'" in refused
                        next(iter(stream))
            finally:
                manager.stop()


MAP = """
window = cm.connect(runtime_dir=runtime, timeout=60).registers.window("prr0")
print(hex(window.ident), flush=True)
try:
    while True:
        window.ident
except WindowRevoked as error:
    print(type(error).__name__, flush=True)
os._exit(0)
"""


@pytest.mark.programs
@needs_root
def test_registers_are_mapped_by_the_role_for_it_and_for_as_long_as_it_is_held(manager: Manager) -> None:
    act = "board.registers.window('prr0').region"
    told = outcome(manager, ALICE, act)[act]
    assert told.startswith("RequestForbidden: forbidden: ")
    assert "takes the role map" in told
    assert outcome(manager, CARL, act) == {act: "prr0"}
    settings = manager.runtime.parent / "cm.yaml"
    with as_user(MAP, manager, FRED) as held:
        assert held.stdout is not None
        assert held.stdout.readline() == "0xca3e0001\n"
        settings.write_text(settings.read_text().replace("[map]", "[operate]"))
        assert held.stdout.read() == "WindowRevoked\n"
    with manager.connected() as board:
        assert board.status.windows == ()


# Reads over a connection of its own: what it is told first, and for as long as it is answered.
READ = """
connection = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
connection.connect(runtime + "/data")
connection.send(p.encode_open(p.Open("", p.Purpose.REGISTERS)))
print(connection.recv(4096)[2], flush=True)
answered = True
while answered:
    try:
        connection.send(p.Descriptor(kind=p.READ).pack() + b"led")
        answered = connection.recv(4096)
    except OSError:
        answered = False
print("over", flush=True)
"""


@pytest.mark.programs
@needs_root
def test_registers_are_read_by_name_by_who_may_observe_all_and_for_as_long_as_that_is_so(manager: Manager) -> None:
    settings = manager.runtime.parent / "cm.yaml"
    with as_user(READ, manager, GINA) as held:
        assert held.stdout is not None
        assert held.stdout.readline() == f"{packets.REGISTERS}\n"
        settings.write_text(settings.read_text().replace("[observe]", "[]"))
        assert held.stdout.read() == "over\n"


@pytest.mark.programs
@needs_root
def test_who_may_read_some_registers_reads_these_by_requests(manager: Manager) -> None:
    assert ended(as_user(READ, manager, HUGO)) == f"{packets.REFUSED}\nover\n"
    many = "{board.registers['led'] for _ in range(50)}"
    told = outcome(manager, HUGO, many, "board.registers['focus']")
    assert told[many] == "{0}"
    assert told["board.registers['focus']"].startswith("RequestForbidden: ")


@pytest.mark.programs
@needs_root
def test_what_one_user_sent_another_does_not_replace_nor_remove(manager: Manager) -> None:
    path = manager.runtime.parent / "mine.yaml"
    path.write_text("config: {name: mine, modules: {a: {bitstream: a.bit}}, modes: {m: {modules: [a]}}}\n")
    path.chmod(0o644)
    send, remove = f"board.provision({str(path)!r}).name", "board.remove_config('mine')"
    assert outcome(manager, CARL, send) == {send: "mine"}
    whose = "[(e.origin, e.owner) for e in board.config_entries() if e.name == 'mine']"
    told = outcome(manager, DORA, send, remove, whose)
    refused = "RequestForbidden: forbidden: configuration 'mine' was sent by"
    assert [told[act].startswith(refused) for act in (send, remove)] == [True, True]
    assert f"('client', 'user (uid {CARL}" in told[whose]
    assert outcome(manager, CARL, remove) == {remove: "None"}


def test_a_manager_whose_log_goes_to_a_full_disk_serves_on() -> None:
    with (
        short_folder() as folder,
        SimBoard([CAMERA], root=folder / "board") as sim,
        Path("/dev/full").open("wb") as full,
    ):
        command = [sys.executable, "-m", "cm", "serve", "-v", "--runtime-dir", str(folder / "run")]
        command += ["--config", str(CAMERA), "--root", str(sim.root), "--state-dir", str(folder / "state")]
        process = subprocess.Popen(command, stderr=full, env=environment(), cwd=REPOSITORY)
        try:
            until((folder / "run/endpoints.json").exists, timeout=60)
            with cm.connect(runtime_dir=folder / "run", timeout=60) as board:
                board.load("camera", "edge_detection")
                with pytest.raises(CmError):
                    board.load("nothing")
                assert board.status.mode == "edge_detection"
        finally:
            process.terminate()
            assert process.wait(60) == 0


MODES = {
    "run": 0o750,
    "run/data": 0o660,
    "run/endpoints.json": 0o640,
    "run/lock": 0o600,
    "run/pub": 0o660,
    "run/req": 0o660,
    "run/sub": 0o660,
    "state": 0o700,
    "state/configs": 0o700,
    "state/configs/mine": 0o700,
    "state/configs/mine/.owner": 0o600,
    "state/configs/mine/schema.yaml": 0o600,
    "state/journal": 0o600,
    "state/journal.new": 0o600,
}


@pytest.mark.parametrize("umask", [0o000, 0o007])
def test_what_the_manager_writes_is_its_own_but_for_what_clients_read_whatever_the_umask(umask: int) -> None:
    with short_folder() as folder, SimBoard([CAMERA], root=folder / "board") as sim:
        settings = folder / "cm.yaml"
        settings.write_text(f"state_dir: {folder}/state\naccess: {{group: '{os.getegid()}'}}\n")
        manager = Manager(
            folder / "run", "--settings", str(settings), "--config", str(CAMERA), "--root", str(sim.root), service=True
        )
        (folder / "a.bit").write_bytes(b"123")
        (folder / "mine.yaml").write_text(
            "config: {name: mine, modules: {a: {bitstream: a.bit}}, modes: {m: {modules: [a]}}}\n"
        )
        before = os.umask(umask)
        try:
            manager.start()
        finally:
            os.umask(before)
        try:
            with manager.connected() as board:
                board.provision(folder / "mine.yaml")
                board.load("camera", "default")
                board.load("camera", "edge_detection")
            found = {}
            for path in (*(folder / "run").rglob("*"), *(folder / "state").rglob("*")):
                found[str(path.relative_to(folder))] = stat.S_IMODE(path.stat().st_mode)
            found |= {name: stat.S_IMODE((folder / name).stat().st_mode) for name in ("run", "state")}
        finally:
            manager.stop()
    assert found == MODES


# Each request over ZeroMQ, as itself or for a guest, and each purpose over the data socket: whether it is refused.
TRY = """
P = p.Purpose
REQUESTS = [
    rq.ReadStatus(), rq.ReadConfig("camera"), rq.ListConfigs(), rq.PlanChange("camera", mode="default"),
    rq.ChangeMode("camera", "none"), rq.CancelChange(), rq.Provision("config: ["), rq.RemoveConfig("none"),
    rq.ReadReg(("led",)), rq.WriteReg((rq.RegWrite("none", 1),)), rq.DescribeData("camera"),
    rq.ConfigureStream("none", enable=False), rq.DefineMemory("none", address=0), rq.ReadData("none"),
    rq.WriteData("none", b"1"), rq.Upload("none", 0), rq.CheckRegion("none"), rq.MapRegion("none"), rq.ReadIrq("none"),
    rq.TakeLease("region:none"), rq.RenewLease("none"), rq.ReleaseLease("none"), rq.BreakLease(99),
]
OPENS = [
    p.Open("camera"), p.Open("to_pl", P.WRITE), p.Open("to_pl", P.TRANSFER), p.Open("", P.ECHO, length=4096),
    p.Open("", P.ALLOCATE, length=4096), p.Open("static", P.WINDOW), p.Open("static", P.WRITABLE_WINDOW),
    p.Open("", P.REGISTERS),
]

def code(reply):
    return reply.error.code if reply.error else ""

def asked(guest):
    try:
        with cm.connect(runtime_dir=runtime, timeout=60, **({"guest": guest} if guest else {})) as board:
            return {type(r).__name__: board.ask(Call(r, code)) == "forbidden" for r in REQUESTS}
    except CmError as error:
        assert error.code == "forbidden", error
        return {type(r).__name__: True for r in REQUESTS}

def opened(wanted):
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as connection:
        connection.settimeout(60)
        connection.connect(runtime + "/data")
        connection.send(p.encode_open(wanted))
        packet, fds, _, _ = socket.recv_fds(connection, p.PACKET_MAX, p.FDS_MAX)
        for fd in fds:
            os.close(fd)
        return packet[2] == p.REFUSED and p.decode_refused(packet)[0] == "forbidden"

said = {guest: asked(guest) for guest in more or [""]}
print(json.dumps([said, {} if more else {wanted.purpose.name: opened(wanted) for wanted in OPENS}]))
"""
FIRST = 47130  # user of the lowest role


def tried(manager: Manager, uid: int, *guests: str) -> Any:
    return json.loads(ended(as_user(TRY, manager, uid, *guests)))


@pytest.mark.programs
@needs_root
def test_each_request_is_refused_at_each_door_to_each_role_below_its_own() -> None:
    """The table of docs/security.md, cell by cell, as other accounts."""
    with short_folder() as folder, SimBoard([CAMERA], root=folder / "board") as sim:
        folder.chmod(0o755)
        names = {role: role.name.lower() if role else "" for role in Role}
        users = ", ".join(f"{FIRST + role}: [{name}]" for role, name in names.items())
        guests = ", ".join(f"'to:{role.name}': [{name}]" for role, name in names.items())
        settings = folder / "cm.yaml"
        settings.write_text(
            f"state_dir: {folder}/state\n"
            f"access: {{group: '{GROUP}', local: [], users: {{{users}}}, guests: {{{guests}}}}}\n"
        )
        arguments = ("--settings", str(settings), "--config", str(CAMERA), "--root", str(sim.root))
        manager = Manager(folder / "run", *arguments, service=True).start()
        try:
            with manager.connected() as board:
                board.load("camera", "default")
            through = tried(manager, FIRST + Role.ADMIN, *(f"to:{role.name}" for role in Role))[0]
            for role in Role:
                wanted = {row.kind.__name__: role < row.right.least.role for row in ROWS}
                itself, opened = tried(manager, FIRST + role)
                assert itself[""] == wanted, role
                assert through[f"to:{role.name}"] == wanted, role
                assert opened == {purpose.name: role < right.least.role for purpose, right in OPENING.items()}, role
        finally:
            manager.stop()
