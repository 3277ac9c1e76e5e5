# SPDX-License-Identifier: Apache-2.0
"""Time-outs as programs give them, and errors that go to other processes."""

from __future__ import annotations

import copy
import grp
import math
import os
import pickle
import re
import socket
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest

from cm.client import find_manager
from cm.client.attribute_guard import Guarded
from cm.client.core import calls
from cm.client.core.events import InterruptEvents
from cm.client.core.flow_effects import DEFAULT, Ask, Deadline, seconds
from cm.client.core.remote_stream import reading_next
from cm.client.core.value_checks import mode_name
from cm.client.errors import ConnectionLost, FrameReleased, NoAnswer, NotAdmitted, request_error
from cm.client.find_manager import Keys, load_keys, resolve
from cm.device.errors import device_error
from cm.errors import CmError, InvalidRequest, NotFound
from cm.networks.bridge.commands import BridgeEnds
from cm.networks.fleet.errors import FleetRefused
from cm.schema.problems import Problem, SchemaError
from cm.wire.encode import encode_request
from cm.wire.messages.requests import ReadData, RegWrite
from cm.wire.messages.status import ErrorInfo
from cm.wire.topics import ipc_endpoints


@pytest.mark.parametrize(
    ("given", "meant"), [(0, 0), (2.5, 2.5), (None, None), (math.inf, None), (1e12, None), (-1, 0.0), (-math.inf, 0.0)]
)
def test_a_time_out_is_a_number_of_seconds_or_for_ever(given: Any, meant: float | None) -> None:
    assert seconds(given, 5.0) == meant
    assert seconds(DEFAULT, meant) == meant
    assert Deadline(given).limit == meant


@pytest.mark.parametrize("given", [math.nan, "5", [1]])
def test_what_is_no_time_is_no_time_out(given: Any) -> None:
    with pytest.raises(InvalidRequest, match="a number of seconds, or None"):
        seconds(given, 5.0)


def test_subscribing_waits_for_the_manager_whatever_the_time_out_for_events() -> None:
    waits = next(InterruptEvents(object(), 0.0, "frame_done").opening())  # type: ignore[arg-type]
    assert 4 < waits.timeout <= 5  # type: ignore[union-attr]


def test_a_frame_without_a_time_out_is_asked_for_again_and_again() -> None:
    flow = reading_next("camera", None, 2.0)
    first = next(flow)
    assert isinstance(first, Ask)
    assert isinstance(first.call.request, ReadData)
    assert first.timeout == first.call.request.timeout + 2.0  # type: ignore[operator]
    again = flow.throw(request_error(ErrorInfo("timeout", "no frame")))
    assert again.call.request == first.call.request  # type: ignore[union-attr]
    with pytest.raises(StopIteration):
        flow.send(object())


def test_a_frame_that_need_not_be_waited_for_is_not_waited_for_a_second() -> None:
    """A time-out of 0 would be the manager's own default."""
    flow = reading_next("camera", 0.0, None)
    asked: Any = next(flow)
    assert 0 < asked.call.request.timeout < 0.1
    with pytest.raises(CmError, match="no frame"):
        flow.throw(request_error(ErrorInfo("timeout", "no frame")))


ERRORS = [
    request_error(ErrorInfo("held_by", "held by the test")),
    request_error(ErrorInfo("timeout", "no frame")),
    request_error(ErrorInfo("forbidden", "observers only")),
    request_error(ErrorInfo("unknown_mode", "no mode egde")),
    request_error(ErrorInfo("icap", "a CRC")),
    NoAnswer("no answer"),
    ConnectionLost("it went away"),
    FrameReleased("given back"),
    device_error(16, "open", "/dev/cm_icap"),
    SchemaError([Problem(Path("a.yaml"), 1, 2, "config", "unknown_key", "no such key")]),
    FleetRefused({"b1": ErrorInfo("busy", "in use")}),
    BridgeEnds(),
]


@pytest.mark.parametrize("error", ERRORS, ids=lambda error: type(error).__name__)
@pytest.mark.parametrize(
    "again", [lambda error: pickle.loads(pickle.dumps(error)), copy.copy, copy.deepcopy], ids=["pickle", "copy", "deep"]
)
def test_an_error_arrives_in_another_process_as_it_was(error: CmError, again: Any) -> None:
    """One that cannot be unpickled breaks a whole pool of processes."""
    error.args = error.args  # as `raise` leaves it
    arrived = again(error)
    assert type(arrived) is type(error)
    assert (str(arrived), repr(arrived), arrived.code) == (str(error), repr(error), error.code)
    assert {n: str(v) for n, v in vars(arrived).items()} == {n: str(v) for n, v in vars(error).items()}
    assert getattr(arrived, "errno", None) == getattr(error, "errno", None)
    assert getattr(arrived, "filename", None) == getattr(error, "filename", None)


def test_pairs_write_a_register_several_times() -> None:
    pairs: list[tuple[str, int | str]] = [("start", 1), ("focus", 2), ("start", 0)]
    request: Any = calls.write_registers(pairs).request
    assert request.writes == (RegWrite("start", 1), RegWrite("focus", 2), RegWrite("start", 0))


@pytest.mark.parametrize("value", [0, 7, (1 << 64) - 1, np.uint8(7), np.int64(7)])
def test_a_register_takes_an_integer(value: Any) -> None:
    request: Any = calls.write_registers({"focus": value}).request
    assert request.writes == (RegWrite("focus", int(value)),)
    assert type(request.writes[0].value) is int


def test_a_fields_value_may_be_named() -> None:
    request: Any = calls.write_registers({"control.mode": "fast"}).request
    assert request.writes == (RegWrite("control.mode", 0, named="fast"),)


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (True, "an integer, not True: write 1"),
        (np.bool_(False), r"an integer, not .*False.*: write 0"),
        (1.0, r"an integer, not 1\.0 \(float\)"),
        ("", r"an integer, not '' \(str\)"),
        (None, r"an integer, not None \(NoneType\)"),
        (-1, r"an integer from 0 to 2\*\*64 - 1, not -1; in 32 bits that is 0xffffffff$"),
        (-(1 << 31) - 1, r"an integer from 0 to 2\*\*64 - 1, not -2147483649$"),
        (1 << 64, r"an integer from 0 to 2\*\*64 - 1, not 18446744073709551616$"),
    ],
)
def test_what_is_no_integer_of_a_register_is_refused(value: Any, words: str) -> None:
    with pytest.raises(InvalidRequest, match=f"^register 'focus' takes {words}"):
        calls.write_registers({"focus": value})


@pytest.mark.parametrize("mode", ["", None, 3, b"edge"])
def test_a_mode_is_named_by_a_word(mode: Any) -> None:
    assert mode_name("edge") == "edge"
    with pytest.raises(InvalidRequest, match=rf"a mode is named by a word, not {mode!r}; load\(config\) goes to its"):
        mode_name(mode)


@pytest.mark.parametrize("given", ["focus", 3, [("focus",)], [3]])
def test_what_is_no_writes_is_refused_in_a_sentence(given: Any) -> None:
    with pytest.raises(InvalidRequest, match=r"\{name: value\}, or pairs"):
        calls.write_registers(given)


@pytest.mark.parametrize(
    "call",
    [
        calls.load(3, "", wait=True, queue=True, force=False, lease=""),  # type: ignore[arg-type]
        calls.read_registers((["focus"],)),  # type: ignore[arg-type]
        calls.describe(b"\xff"),  # type: ignore[arg-type]
        calls.interrupt("\ud800"),
        calls.read_memory("scratchpad", -4, 4),
    ],
)
def test_what_no_message_can_hold_is_refused_as_any_request(call: calls.Call[Any]) -> None:
    with pytest.raises(InvalidRequest):
        encode_request(call.request)


def test_a_folder_may_be_a_path(tmp_path: Path) -> None:
    (tmp_path / "req").touch()
    assert resolve(tmp_path, None) == resolve(str(tmp_path), None) == resolve(None, tmp_path)


@pytest.mark.parametrize("endpoint", ["TCP://kria.local", "udp://kria.local:5560", "http://kria.local"])
def test_an_address_of_another_kind_is_no_folder(endpoint: str) -> None:
    with pytest.raises(InvalidRequest, match=r"tcp://host\[:port\]"):
        resolve(endpoint, None)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"\x7fELF\xff\xfe", "not a key file"),
        (b"server-public: a\npublic: b\nsecret: c\n", "40 characters"),
        (b"public: b\n", "no 'server-public' key"),
    ],
)
def test_a_file_that_is_no_key_file_is_named(tmp_path: Path, content: bytes, says: str) -> None:
    path = tmp_path / "my.key"
    path.write_bytes(content)
    with pytest.raises(InvalidRequest, match=rf"my\.key.*{says}"):
        load_keys(path)


@pytest.mark.parametrize(("name", "at"), [("server_public", 0), ("public", 1), ("secret", 2)])
def test_keys_are_checked_when_they_are_made(name: str, at: int) -> None:
    keys = [b"0" * 40] * 3
    keys[at] = b"0" * 39
    with pytest.raises(InvalidRequest, match=f"^the key {name} is not one: keys are 40 characters of Z85"):
        Keys(*keys)


class Locked:
    """A folder that we may not look into."""

    def __truediv__(self, name: str) -> Locked:
        return self

    def exists(self) -> bool:
        raise PermissionError


@pytest.mark.parametrize(
    ("system", "own", "user", "found"),
    [
        (True, True, 1000, "system"),
        (False, True, 1000, "own"),
        (False, False, 1000, "own"),
        (False, True, 0, "system"),
        (None, True, 1000, "own"),
        (None, False, 1000, "system"),  # the error says that we may not use it
    ],
)
def test_a_client_that_names_no_manager_takes_the_systems_or_else_its_users(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, system: bool | None, own: bool, user: int, found: str
) -> None:
    for folder, serves in (("system", system), ("own/cm", own)):
        (tmp_path / folder).mkdir(parents=True)
        if serves:
            (tmp_path / folder / "req").touch()
    folder = Locked() if system is None else tmp_path / "system"
    monkeypatch.setattr(find_manager, "SYSTEM_DIR", folder)
    monkeypatch.setattr(os, "geteuid", lambda: user)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "own"))
    monkeypatch.delenv("CM_RUNTIME_DIR", raising=False)
    assert find_manager.default_runtime_dir() == (folder if found == "system" else tmp_path / "own" / "cm")
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    if found == "own" and not own:
        assert find_manager.default_runtime_dir() == Path(f"/tmp/cm-{os.getuid()}")
    monkeypatch.setenv("CM_RUNTIME_DIR", "/chosen")
    assert find_manager.default_runtime_dir() == Path("/chosen")


@pytest.mark.parametrize(
    ("group", "told"),
    [
        ("root", "they are for root, until cm.yaml names an access.group"),
        ("fpga", "they are for members of fpga (sudo usermod -aG fpga $USER, then log in again)"),
        (None, "they are for members of its group (sudo usermod -aG its group $USER, then log in again)"),
    ],
)
def test_sockets_that_are_not_for_this_user_say_for_whom_they_are(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, group: str | None, told: str
) -> None:
    (tmp_path / "req").touch()
    groups = {(tmp_path.stat().st_gid): SimpleNamespace(gr_name=group)} if group else {}
    monkeypatch.setattr(grp, "getgrgid", groups.__getitem__)
    monkeypatch.setattr(os, "access", lambda path, mode: (path, mode) != (tmp_path / "req", os.W_OK))
    with pytest.raises(NotAdmitted) as refused:
        resolve(tmp_path, None)
    assert str(refused.value) == f"this user may not use the sockets in {tmp_path}: {told}"


@pytest.mark.parametrize(
    ("owner", "named", "ours"), [(4242, False, False), (4242, True, True), (0, False, True), (1000, False, True)]
)
def test_a_folder_that_another_user_has_made_is_used_only_if_it_is_named(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, owner: int, named: bool, ours: bool
) -> None:
    folder = tmp_path / "cm"
    folder.mkdir()
    (folder / "req").touch()
    monkeypatch.setattr(find_manager, "SYSTEM_DIR", tmp_path / "none")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.delenv("CM_RUNTIME_DIR", raising=False)
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    stat = Path.stat
    monkeypatch.setattr(
        Path, "stat", lambda self, **how: SimpleNamespace(st_uid=owner) if self == folder else stat(self, **how)
    )
    if ours:
        assert resolve(folder if named else None, None) == ipc_endpoints(folder)
    else:
        with pytest.raises(NotAdmitted, match=f"^{folder} belongs to another user: its manager is not ours$"):
            resolve(None, None)


@pytest.mark.parametrize(
    ("endpoint", "folder", "told"),
    [
        ("tcp://a", "/b", "give an endpoint or a runtime folder, not both"),
        ("", None, "endpoint '': it is tcp://host[:port], or a runtime folder; none at all: this machine's"),
        ("tcp://-a", None, "endpoint 'tcp://-a' is not tcp://host[:port]: a host is a name of ASCII letters, digits, - "
         "and ., or an address, for IPv6 as in tcp://[2001:db8::1]"),
        ("/no/such", None, "no configuration manager serves /no/such: start one ('cm serve', without a board 'cm serve "
         "--sim'), or name its --runtime-dir"),
        ("nosuch", None, "no configuration manager serves nosuch: start one ('cm serve', without a board 'cm serve "
         "--sim'), or name its --runtime-dir; a manager on another machine is tcp://nosuch"),
        ("ipc://tcp://a", None, "endpoint 'ipc://tcp://a': it is tcp://host[:port], or the runtime folder of a manager "
         "here"),
    ],
)  # fmt: skip
def test_a_manager_that_cannot_be_found_is_refused_in_words(endpoint: str, folder: str | None, told: str) -> None:
    with pytest.raises((InvalidRequest, NotFound)) as refused:
        resolve(endpoint, folder)
    assert str(refused.value) == told


@pytest.mark.parametrize("host", ["kria", "kria-2.local", "10.0.0.1", "[fe80::1%eth0]", "a_b", "a*", "1"])
def test_a_host_is_a_name_or_an_address(host: str) -> None:
    assert resolve(f"tcp://{host}:5560", None).req == f"tcp://{host}:5562"


@pytest.mark.parametrize(
    "host", ["[::]", ".a", "-a", "%a", "]a[", "_a", "*a", "[::1", "::1]", "a b", "kri\xe4", "a$", "."]
)
def test_what_is_no_host_is_refused_before_zeromq_does(host: str) -> None:
    with pytest.raises(InvalidRequest, match=r"tcp://host\[:port\]"):
        resolve(f"tcp://{host}:5560", None)


def test_on_other_systems_there_is_no_manager_of_ones_own_and_no_data_socket(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    for name in ("req", "data"):
        (tmp_path / name).touch()
    monkeypatch.delenv("CM_RUNTIME_DIR", raising=False)
    monkeypatch.setattr(find_manager, "sys", SimpleNamespace(platform="win32"))
    told = (
        "a configuration manager runs on a Linux board, not here: say which one, "
        "connect('tcp://kria.local'), --connect tcp://kria.local, or CM_CONNECT=tcp://kria.local"
    )
    with pytest.raises(InvalidRequest, match=f"^{re.escape(told)}$"):
        find_manager.find(None, None, None)
    place = find_manager.find(tmp_path, None, None)
    assert (place.data, place.local, find_manager.deserted(place.endpoints.req)) == (None, True, "")
    monkeypatch.setattr(os, "access", lambda *_: False)
    with pytest.raises(NotAdmitted, match=r"members of its group \(sudo usermod -aG its group "):
        resolve(tmp_path, None)


def test_a_key_may_have_a_colon_in_it_and_a_comment_none_of_the_keys(tmp_path: Path) -> None:
    keys = [("0" * n + ":" + "0" * (39 - n)) for n in (0, 20, 39)]
    lines = [f"{name}: {key}" for name, key in zip(("server-public", "public", "secret"), keys, strict=True)]
    (tmp_path / "my.key").write_text("\n".join(["made by cm", *lines, "# secret: none"]))
    assert load_keys(tmp_path / "my.key") == Keys(*(key.encode() for key in keys))


def test_a_guests_name_has_64_characters_at_most_and_keys_are_looked_for_where_a_network_is_between(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "my.key").write_text("".join(f"{name}: {'0' * 40}\n" for name in ("server-public", "public", "secret")))
    monkeypatch.setenv("CM_KEYS", str(tmp_path / "my.key"))
    place = find_manager.find("tcp://kria.local", None, None, "g" * 64)
    assert (place.keys, place.guest, place.local) == (Keys(*[b"0" * 40] * 3), "g" * 64, False)
    with pytest.raises(InvalidRequest, match="a name of at most 64 characters, all printable"):
        find_manager.find("tcp://kria.local", None, None, "g" * 65)
    for name in ("req", "data"):
        (tmp_path / name).touch()
    monkeypatch.setenv("CM_CONNECT", str(tmp_path))
    place = find_manager.find(None, None, None)
    assert (place.keys, place.local, place.data, place.data_folder("it")) == (None, True, tmp_path, tmp_path)
    guest = find_manager.find(None, tmp_path, None, "ann")
    assert (guest.data, guest.endpoints) == (None, place.endpoints)


def test_why_no_answer_comes_is_found_out_from_the_socket(
    monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.mktemp("s") / "req"
    with socket.socket(socket.AF_UNIX) as left, socket.create_server(("127.0.0.1", 0)) as there:
        left.bind(str(path))
        left.listen()
        assert find_manager.deserted(f"ipc://{path}") == ""
        port = there.getsockname()[1]
        assert find_manager.unreached(f"tcp://127.0.0.1:{port}") == ""
    told = "nobody serves that socket any more, the manager was killed; start it again"
    assert find_manager.deserted(f"ipc://{path}") == told
    assert (find_manager.deserted("tcp://kria"), find_manager.unreached(f"ipc://{path}")) == ("", "")

    def refused(address: tuple[str, int], limit: float) -> Any:
        raise ConnectionRefusedError

    def unknown(host: str, port: Any) -> Any:
        raise socket.gaierror(-2, f"no {host}")

    monkeypatch.setattr(socket, "create_connection", refused)
    told = "nothing listens on port 5 there, as a manager with 'listen' does"
    assert find_manager.unreached("tcp://[::1]:5") == told
    monkeypatch.setattr(socket, "getaddrinfo", unknown)
    assert find_manager.unreached("tcp://kria:5") == "the name 'kria' does not resolve (no kria)"
    assert find_manager.unreached("tcp://[::1]:5") == "the name '::1' does not resolve (no ::1)"


class Lamp(Guarded):
    _advice: ClassVar = {"colour": "a lamp has no colour"}
    bright: bool

    @property
    def state(self) -> int:
        return self._state

    @state.setter
    def state(self, value: int) -> None:
        self._state = value

    @property
    def power(self) -> int:
        return 7


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("colour", "a lamp has no colour"),
        ("power", "Lamp.power cannot be set"),
        ("bright", "Lamp.bright cannot be set"),
        ("powr", "Lamp has no 'powr': did you mean 'power'?"),
        ("zzz", "Lamp has no 'zzz'"),
    ],
)
def test_an_attribute_that_cannot_be_set_is_refused_with_what_was_meant(name: str, told: str) -> None:
    lamp = Lamp()
    lamp.state = 3
    assert lamp.state == 3
    with pytest.raises(AttributeError) as refused:
        setattr(lamp, name, 1)
    assert str(refused.value) == told
    with pytest.raises(TypeError, match=r"can be neither pickled nor copied: connect\(\) there$"):
        copy.copy(lamp)
