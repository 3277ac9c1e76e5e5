# SPDX-License-Identifier: Apache-2.0
"""Schemas, settings and rights that are reread while the daemon serves."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from typing import Any

import pytest
import zmq
from daemon_thread import HUNG, Daemon, daemon
from data_client import Client
from manager_process import CAMERA, until

from cm.errors import InvalidRequest
from cm.schema import load_folder
from cm.schema.model import Config
from cm.server.options import Reloaded
from cm.server.rights.model import Access
from cm.server.settings.model import USUAL
from cm.wire import plane_packets as packets
from cm.wire.encode import decode_reply, encode_request
from cm.wire.messages import requests as rq
from cm.wire.messages.requests import ChangeMode
from cm.wire.plane_packets import Open, Purpose

MIB = 1 << 20
SMALL = "config: {name: a, modules: {m: {}}, modes: {m: {modules: [m]}}}"
ACCESS = Access()


class Source:
    """A source that is reread, and how often it was."""

    def __init__(self) -> None:
        self.camera = load_folder(CAMERA)["camera"]
        self.found: Reloaded | Exception = Reloaded({"camera": self.camera}, ACCESS)
        self.stamp = 0
        self.read = 0

    def __call__(self) -> Reloaded:
        self.read += 1
        if isinstance(self.found, Exception):
            raise self.found
        return self.found

    def named(self, name: str, **more: Any) -> Config:
        """The camera's configuration by another name, from another text."""
        return replace(self.camera, name=name, sha256_source=name, **more)


@pytest.fixture
def source() -> Source:
    return Source()


@pytest.fixture
def served(source: Source) -> Iterator[Daemon]:
    given = {"reload": source, "changed": lambda: source.stamp, "access": ACCESS}
    with daemon(**given) as made:
        (made.board.root / "lib/firmware/cm/other").symlink_to("camera")
        yield made


@pytest.fixture
def reload(served: Daemon, source: Source) -> Callable[[Reloaded | Exception], None]:
    """Reload, and wait until it takes effect: a later request is answered after it."""

    def begin(found: Reloaded | Exception) -> None:
        source.found, before = found, source.read
        served.server.reload()
        until(lambda: source.read > before, HUNG / 1000)

    return begin


def names(daemon: Daemon) -> set[str]:
    return set(daemon.done(rq.ListConfigs()).names)


# ---- configurations ----------------------------------------------------------------------------


def test_new_configurations_appear_and_removed_ones_disappear(served: Daemon, source: Source, reload: Any) -> None:
    reload(Reloaded({"camera": source.camera, "other": source.named("other")}, ACCESS))
    until(lambda: names(served) == {"camera", "other"})
    reload(Reloaded({"camera": source.camera}, ACCESS))
    until(lambda: names(served) == {"camera"})
    assert served.refused(ChangeMode("other", "default"))[0] == "unknown_config"


def test_a_loaded_configuration_keeps_its_schema_until_it_is_unloaded(
    served: Daemon, source: Source, reload: Any, caplog: pytest.LogCaptureFixture
) -> None:
    served.load("default")
    caplog.set_level(logging.INFO, "cm")
    reload(Reloaded({"other": source.named("other")}, ACCESS, notes=("listen takes a restart",)))
    until(lambda: names(served) == {"camera", "other"})
    until(lambda: "reloaded; configurations: other" in caplog.messages)
    told = [record.getMessage() for record in caplog.records if record.levelno >= logging.WARNING]
    assert told == [
        "configuration camera is in use; its new version takes effect when another is loaded, or by "
        "cm load camera --force",
        "listen takes a restart",
    ]
    served.load("edge_detection")
    served.done(ChangeMode("other", "default"))
    until(lambda: names(served) == {"other"})


def test_a_changed_schema_of_the_loaded_configuration_applies_once_it_is_unloaded(
    served: Daemon, source: Source, reload: Any
) -> None:
    served.load("default")
    fewer = {name: mode for name, mode in source.camera.modes.items() if name != "colorise"}
    changed = source.named("camera", modes=fewer)
    reload(Reloaded({"camera": changed, "other": source.named("other")}, ACCESS))
    until(lambda: "other" in names(served))
    served.load("colorise")
    served.done(ChangeMode("other", "default"))
    until(lambda: served.ask(rq.PlanChange("camera", "colorise")).error is not None)
    assert served.refused(ChangeMode("camera", "colorise"))[0] == "unknown_mode"


def test_a_changed_schema_of_the_loaded_configuration_applies_at_once_to_a_forced_load(
    served: Daemon, source: Source, reload: Any
) -> None:
    """The way out where its bitstreams were built anew: what the old schema says of them is not true any more."""
    served.load("default")
    fewer = {name: mode for name, mode in source.camera.modes.items() if name != "colorise"}
    reload(Reloaded({"camera": source.named("camera", modes=fewer), "other": source.named("other")}, ACCESS))
    until(lambda: "other" in names(served))
    served.done(ChangeMode("camera", "default", force=True))
    assert served.refused(ChangeMode("camera", "colorise"))[0] == "unknown_mode"
    served.load("edge_detection")


def test_a_folder_with_a_damaged_schema_removes_no_configuration(served: Daemon, source: Source, reload: Any) -> None:
    reload(Reloaded({"camera": source.camera, "other": source.named("other")}, ACCESS))
    until(lambda: names(served) == {"camera", "other"})
    reload(Reloaded({"camera": source.camera, "third": source.named("third")}, ACCESS, whole=False))
    until(lambda: names(served) == {"camera", "other", "third"})


@pytest.mark.parametrize("problem", [OSError(5, "no"), InvalidRequest("wrong")])
def test_an_unreadable_file_changes_nothing(
    served: Daemon, source: Source, reload: Any, problem: Exception, caplog: pytest.LogCaptureFixture
) -> None:
    reload(problem)
    until(lambda: f"not reloaded: {problem}" in caplog.messages)
    assert names(served) == {"camera"}
    reload(Reloaded({"camera": source.camera, "other": source.named("other")}, ACCESS))
    until(lambda: names(served) == {"camera", "other"})


def test_settings_that_have_changed_and_stay_are_read_by_itself(served: Daemon, source: Source) -> None:
    assert source.read == 0
    source.found = Reloaded({"camera": source.camera, "other": source.named("other")}, ACCESS)
    source.stamp = 1
    until(lambda: names(served) == {"camera", "other"}, HUNG / 1000)
    assert source.read == 1


def test_bounds_are_those_that_were_read_last(served: Daemon, source: Source, reload: Any) -> None:
    def bounded(**bounds: int) -> None:
        name = f"n{source.read}"
        reload(Reloaded({"camera": source.camera, name: source.named(name)}, ACCESS, replace(USUAL, **bounds)))
        until(lambda: name in names(served))

    served.load("default")
    take = rq.TakeLease("registers:zoom", holder="me")
    held = served.done(rq.TakeLease("registers:focus", holder="me"))
    with closing(Client(served, Open("camera", depth=8))) as first:
        assert first.geometry().depth == 8
        bounded(leases=1, upload_bytes=1, provisioned_each_bytes=1, slots_each=8, memory_each_bytes=MIB)
        for request, code, words in (
            (take, "too_many_leases", "1 may be held"), (rq.Upload("a", 2), "too_much_uploaded", "2 more are too many"),
            (rq.Provision(SMALL, lease=held.id), "quota", "of 1:"),
        ):  # fmt: skip
            found, message = served.refused(request)
            assert (found, words in message) == (code, True), message
        for wanted, code, words in (
            (Open("camera", depth=1), "no_slots", "one user gets 8"),
            (
                Open("", Purpose.ALLOCATE, length=2 * MIB),
                "busy",
                "memory for masters in the PL and echoes is 1 MiB for one user",
            ),
        ):
            with closing(Client(served, wanted)) as other:
                found, message = other.refusal()
            assert (found, words in message) == (code, True), message
        bounded(slots_each=10)
        with closing(Client(served, Open("camera", depth=8))) as second:
            assert second.geometry().depth == 2
        first.next(packets.FRAME)
    for lease in (held, served.done(take)):
        served.done(rq.ReleaseLease(lease.id))


def test_rights_are_those_that_were_read_last(served: Daemon, source: Source, reload: Any) -> None:
    bridge = served.connect(zmq.DEALER, "req")

    def asks_for_ann() -> str:
        bridge.send_multipart([b"1", b"for=web:ann", b"", *encode_request(rq.ReadStatus())])
        error = decode_reply(bridge.recv_multipart()[3:]).error
        return error.code if error else ""

    assert asks_for_ann() == "forbidden"
    reload(Reloaded({"camera": source.camera}, Access(guests={"web:ann": ("observe",)})))
    until(lambda: asks_for_ann() == "")
    bridge.close(linger=0)
