# SPDX-License-Identifier: Apache-2.0
"""Requests at the daemon's sockets: each is answered once, with what was asked for or with a code and a sentence."""

from __future__ import annotations

import json
import logging
import os
from collections.abc import Iterator
from pathlib import Path

import pytest
import zmq
from daemon_thread import Daemon, Subscriber, daemon
from manager_process import patient, stalled, until

from cm.manager.errors import UnknownMode
from cm.server.rights.model import Access
from cm.wire.encode import decode_reply, encode_request
from cm.wire.messages import requests as rq
from cm.wire.messages.requests import ChangeMode, File, ReadReg, RegWrite, WriteReg
from cm.wire.messages.status import Irq, RegValues, Status


@pytest.fixture(scope="module")
def shared() -> Iterator[Daemon]:
    with daemon(name="bench", access=Access(guests={"web:ann": ("observe",)})) as made:
        yield made


@pytest.fixture
def camera(shared: Daemon) -> Daemon:
    """A daemon in the camera's default mode, freshly loaded."""
    shared.done(ChangeMode("camera", "default", force=True))
    return shared


def written(name: str, value: int, mask: int | None = None) -> WriteReg:
    return WriteReg((RegWrite(name, value, mask=mask),))


def values(daemon: Daemon, *names: str) -> list[int]:
    return [value.value for value in daemon.done(ReadReg(names)).values]


# ---- status and configurations -----------------------------------------------------------------


def test_the_status_tells_board_mode_and_regions(camera: Daemon) -> None:
    status = camera.status
    assert (status.config_name, status.mode, status.board) == ("camera", "default", "bench")
    assert {region.name: region.module for region in status.regions}["prr0"] == "default"
    assert not status.fpga_busy
    assert status.last_error is None


def test_statuses_are_numbered_and_replies_say_how_far(camera: Daemon) -> None:
    seen = Subscriber(camera)
    first = seen.first.sequence
    camera.load("edge_detection")
    last = seen.until(Status, lambda status: status.mode == "edge_detection" and not status.fpga_busy)
    assert last.sequence > first
    assert camera.ask(rq.ReadStatus()).sequence >= last.sequence
    seen.close()


def test_a_configuration_is_described_and_all_are_listed(camera: Daemon) -> None:
    described = camera.done(rq.ReadConfig())
    assert described.name == "camera"
    assert {"focus", "zoom"} <= {register.name for register in described.registers}
    assert camera.done(rq.ReadConfig("camera")) == described
    listed = camera.done(rq.ListConfigs())
    assert [entry.name for entry in listed.entries] == list(listed.names)
    (entry,) = [entry for entry in listed.entries if entry.name == "camera"]
    assert (entry.type, entry.default_mode, "edge_detection" in entry.modes) == ("partial", "default", True)


def test_a_description_counts_the_interrupts_that_came(camera: Daemon) -> None:
    reader = Subscriber(camera, b"cm_irq", b"cm_stream/camera")
    count = reader.until(Irq, lambda irq: irq.name == "frame_done").count
    reader.close()
    described = {interrupt.name: interrupt for interrupt in camera.done(rq.ReadConfig()).interrupts}
    assert described["frame_done"].count >= count
    assert camera.done(rq.ReadIrq("frame_done")).count >= count


# ---- changes -------------------------------------------------------------------------------------


def test_a_plan_says_what_would_be_loaded_and_loads_nothing(camera: Daemon) -> None:
    plan = camera.done(rq.PlanChange("camera", "edge_detection"))
    assert (plan.config_name, plan.mode) == ("camera", "edge_detection")
    assert plan.bytes > 0
    assert any(step.kind == "load" for step in plan.steps)
    assert camera.status.mode == "default"
    assert camera.done(rq.PlanChange("camera", "default")).steps == ()


def test_a_change_that_fails_is_answered_with_its_error_and_undone(camera: Daemon) -> None:
    camera.board.control.inject("icap_crc")
    code, _ = camera.refused(ChangeMode("camera", "edge_detection"))
    assert code == "load_failed"
    status = camera.status
    assert (status.mode, status.last_error.code) == ("default", "load_failed")


def test_a_region_is_compared_and_repaired(camera: Daemon) -> None:
    assert camera.done(rq.CheckRegion("prr0")).verdict == "good"
    camera.board.control.upset("prr0")
    mended = camera.done(rq.CheckRegion("prr0", repair=True))
    assert (mended.verdict, mended.repaired, mended.wrong_bits) == ("good", "frames", 1)
    assert camera.refused(rq.CheckRegion("prr9"))[0] == "unknown_region"
    for mode in ("loopback", "loopback_edge", "edge_detection", "colorise", "default"):
        camera.load(mode)
        assert {camera.done(rq.CheckRegion(name)).verdict for name in ("prr0", "prr1")} == {"good"}


def test_a_region_is_told_as_a_map(camera: Daemon) -> None:
    told = camera.done(rq.MapRegion("prr0"))
    assert (told.region, told.module, told.device, told.config_name) == ("prr0", "default", "xc7z020", "camera")
    assert len({column.far for column in told.columns}) == len(told.columns) > 1
    for field in ("bits", "switches", "logic", "clock"):
        assert any(getattr(column, field) for column in told.columns), field
    assert camera.refused(rq.MapRegion("prr9"))[0] == "unknown_region"


# ---- provisioning ----------------------------------------------------------------------------------

EXTRA = """
config:
  name: extra
  device: xc7z020
  regions: {prr0: {decoupler: {base_address: 0x1000, offset: 0, bit: 0}}}
  modules: {default: {region: prr0, bitstream: given.bit}}
  modes: {only: {modules: [default]}}
"""


def image(daemon: Daemon) -> bytes:
    return (daemon.board.root / "lib/firmware/cm/camera/default.bit").read_bytes()


def test_a_configuration_that_is_provisioned_is_described_and_stays(camera: Daemon) -> None:
    told = camera.done(rq.Provision(EXTRA, (File("given.bit", image(camera)),)))
    assert (told.name, [mode.name for mode in told.modes]) == ("extra", ["only"])
    assert camera.status.config_name == "camera"
    assert {"camera", "extra"} <= set(camera.done(rq.ListConfigs()).names)
    assert list((camera.folder / "state").rglob("given.bit"))
    entries = {entry.name: entry.origin for entry in camera.done(rq.ListConfigs()).entries}
    assert (entries["camera"], entries["extra"]) == ("administrator", "client")


def test_a_configuration_is_provisioned_and_entered_in_one(camera: Daemon) -> None:
    change = ChangeMode(mode="only")
    camera.done(rq.Provision(EXTRA, (File("given.bit", image(camera)),), change=change))
    assert (camera.status.config_name, camera.status.mode) == ("extra", "only")


# ---- registers ---------------------------------------------------------------------------------------


def test_registers_are_written_read_and_published(camera: Daemon) -> None:
    seen = Subscriber(camera, b"cm_read_reg")
    told = camera.done(WriteReg((RegWrite("focus", 5), RegWrite("led", 0x2A))))
    assert [(value.name, value.value) for value in told.values] == [("focus", 5), ("led", 0x2A)]
    published = seen.until(RegValues)
    assert [(value.name, value.value) for value in published.values] == [("focus", 5), ("led", 0x2A)]
    assert values(camera, "led", "focus") == [0x2A, 5]
    seen.close()


def test_fields_are_reported_beside_the_value(camera: Daemon) -> None:
    camera.done(written("led", 0x2A))
    (led,) = camera.done(ReadReg(("led",))).values
    assert dict(led.fields) == {"pattern": 0xA, "blink": 2}
    camera.done(written("led.blink", 1))
    camera.done(written("zoom", 2))
    for _ in range(3):  # the first answer takes the slow path
        assert values(camera, "led", "led.blink", "zoom", "led") == [0x1A, 1, 2, 0x1A]


def test_a_repeated_read_after_a_change_of_mode_is_of_the_new_mode(camera: Daemon) -> None:
    assert values(camera, "ident") == [0xCA3E0001]
    assert values(camera, "ident") == [0xCA3E0001]
    camera.load("edge_detection")
    assert values(camera, "ident") == [0xCA3E0002]
    camera.done(written("threshold", 9))
    assert values(camera, "threshold") == [9]
    camera.load("default")
    assert {camera.refused(ReadReg(("threshold",)))[0] for _ in range(3)} == {"unknown_register"}


@pytest.mark.parametrize(
    ("request_", "code", "words"),
    [
        (ReadReg(("focsu",)), "unknown_register", "did you mean 'focus'?"),
        (written("focsu", 1), "unknown_register", "did you mean 'focus'?"),
        (ReadReg(("threshold",)), "unknown_register", "modes edge_detection have it"),
        (ReadReg(("led.zzz",)), "unknown_register", "'led' has no field 'zzz'; there are blink, pattern"),
        (ReadReg(("zoom.zzz",)), "unknown_register", "'zoom' has no field 'zzz'; there are none"),
        (written("focus", 1, mask=1 << 32), "out_of_range", "mask 0x100000000 does not fit 32 bits"),
        (
            rq.DefineMemory("camera", 0x1A00, length=16),
            "invalid_request",
            "'camera' is a stream of configuration 'camera'",
        ),
        (
            rq.DefineMemory("scratchpad", 0x1A00, length=16),
            "invalid_request",
            "'scratchpad' is a memory of configuration",
        ),
        (written("version", 1), "access", "read-only"),
        (written("focus", 16), "out_of_range", "register 'focus': 16 (0x10) is outside 0 to 15"),
        (written("led.blink", 9, 1), "invalid_request", "give a value or a mask, not both"),
        (ChangeMode("camera", "edges_detection"), "unknown_mode", "did you mean 'edge_detection'?"),
        (ChangeMode("camera", "edge"), "unknown_mode", "no mode 'edge'; mode 'edge_detection' has that module alone"),
        (rq.Provision("config: {name: x, modes: 3}"), "schema_invalid", "1:"),
        (rq.ReadConfig("camra"), "unknown_config", "did you mean 'camera'?"),
        (rq.ReadIrq("frame_don"), "unknown_interrupt", "did you mean 'frame_done'?"),
        (rq.RenewLease("none"), "unknown_lease", "none"),
        (rq.TakeLease("registers:nothing"), "not_found", "nothing"),
        (rq.TakeLease("board", pid=(1 << 22) + 1), "invalid_request", "no process has a number above 4194304"),
        (rq.ReadData("nothing"), "unknown_stream", "nothing"),
        (rq.WriteData("nothing", b"1"), "unknown_stream", "nothing"),
        (rq.DescribeData("nothing"), "unknown_stream", "nothing"),
        (rq.DefineMemory("block", 0x1000, length=3), "invalid_request", "4"),
    ],
)
def test_impossible_requests_are_refused_with_their_codes(
    camera: Daemon, request_: rq.Request, code: str, words: str
) -> None:
    found, message = camera.refused(request_)
    assert (found, words in message) == (code, True), message


# ---- leases --------------------------------------------------------------------------------------------


def test_a_lease_keeps_others_from_writing_until_it_is_given_back(
    camera: Daemon, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "cm")
    lease = camera.done(rq.TakeLease("registers:focus", holder="me"))
    (told,) = camera.status.leases
    assert told.client.startswith(f"pid {os.getpid()} (")
    assert f"lease on registers:focus taken by {told.client} for me" in caplog.messages
    code, message = camera.refused(written("focus", 3))
    assert (code, "me" in message) == ("held_by", True)
    camera.done(WriteReg((RegWrite("focus", 4),), lease.id))
    camera.done(written("zoom", 2))
    renewed = camera.done(rq.RenewLease(lease.id, 60))
    assert renewed.id == lease.id
    camera.done(rq.ReleaseLease(lease.id))
    camera.done(written("focus", 3))
    assert values(camera, "focus") == [3]


def test_a_lease_on_a_region_keeps_others_from_repairing_it(camera: Daemon) -> None:
    lease = camera.done(rq.TakeLease("region:prr0", holder="me"))
    assert camera.refused(rq.CheckRegion("prr0", repair=True))[0] == "held_by"
    assert camera.done(rq.CheckRegion("prr0", repair=True, lease=lease.id)).verdict == "good"
    camera.done(rq.ReleaseLease(lease.id))


@pytest.mark.parametrize(("guest", "reads"), [("web:ann", ""), ("web:eve", "forbidden")])
def test_a_bridge_asks_with_the_rights_of_its_guest(camera: Daemon, guest: str, reads: str) -> None:
    bridge = camera.connect(zmq.DEALER, "req")
    for request, code in ((ReadReg(("focus",)), reads), (written("focus", 3), "forbidden")):
        bridge.send_multipart([b"1", f"for={guest}".encode(), b"", *encode_request(request)])
        error = decode_reply(bridge.recv_multipart()[3:]).error
        assert (error.code if error else "") == code
        assert error is None or error.message.startswith(f"{guest} through ipc:")
    bridge.close(linger=0)


# ---- memories ------------------------------------------------------------------------------------------


def test_a_memory_is_written_and_read_by_bytes(camera: Daemon) -> None:
    camera.done(rq.WriteData("scratchpad", bytes(range(64)), offset=16))
    reply = camera.ask(rq.ReadData("scratchpad", offset=20, length=8))
    assert bytes(reply.payload[0]) == bytes(range(4, 12))
    assert (reply.body.stream, reply.body.offset, reply.body.length) == ("scratchpad", 20, 8)
    assert (reply.body.shape, reply.body.dtype) == ((2,), "uint32")
    whole = camera.done(rq.ReadData("scratchpad"))
    assert (whole.shape, whole.dtype, whole.mode) == ((16, 32), "uint32", "default")
    info = camera.done(rq.DescribeData("scratchpad"))
    assert (info.name, info.size, info.dtype) == ("scratchpad", 0x800, "uint32")
    assert camera.refused(rq.ReadData("scratchpad", offset=0x800, length=4))[0] == "out_of_range"
    assert camera.refused(rq.ConfigureStream("scratchpad", slots=3))[0] == "invalid_request"


def test_a_block_is_defined_and_used(camera: Daemon) -> None:
    info = camera.done(rq.DefineMemory("block", 0x1A00, length=32, shape=(8,), dtype="uint32", access="ro"))
    assert (info.address, info.size, info.defined) == (0x1A00, 32, True)
    camera.done(rq.WriteData("scratchpad", b"\1" * 4, offset=0x200))
    assert bytes(camera.ask(rq.ReadData("block", length=4)).payload[0]) == b"\1" * 4
    assert camera.refused(rq.WriteData("block", b"\1" * 4))[0] == "access"


# ---- the sockets ---------------------------------------------------------------------------------------


def test_a_message_without_a_reply_takes_effect_and_its_error_is_reported(camera: Daemon) -> None:
    seen = Subscriber(camera, b"cm_read_reg")
    sender = camera.connect(zmq.XPUB, "sub")
    assert sender.recv() == b"\1cm_"
    sender.send_multipart([b"cm_write_reg", b"{ 'focus':0x2}"])
    assert seen.until(RegValues).values[0].value == 2
    sender.send_multipart([b"cm_write_reg", b"{ 'focsu':0x2}"])
    told = seen.until(Status, lambda status: status.last_error is not None)
    assert told.last_error.code == "unknown_register"
    sender.send(b"cm_config edge")
    assert seen.until(Status, lambda status: not status.fpga_busy and status.mode == "edge_detection")
    sender.close(linger=0)
    seen.close()


def test_a_message_that_is_not_a_request_is_answered(camera: Daemon) -> None:
    for frames, words in (([b"cm_nothing", b""], "unknown topic"), ([b"cm_status", b"", b"x"], "payload")):
        error = camera.raw(*frames).error
        assert error is not None
        assert (error.code, words in error.message) == ("invalid_request", True)


def test_a_read_that_was_made_before_does_not_overtake_a_write_that_waits(tmp_path: Path) -> None:
    with daemon(schemas=patient(tmp_path)) as made:
        made.load("default")
        assert [[values(made, "scratch"), values(made, "focus")] for _ in range(3)] == [
            [[0], [1]]
        ] * 3  # from here on it is answered without decoding
        with stalled(made.board):
            for request in (ChangeMode("camera", "edge_detection"), written("focus", 7), written("scratch", 3)):
                made.send(request)
            made.send(ReadReg(("scratch",)))
            other = made.connect(zmq.DEALER, "req")
            codes = set[str]()
            while "region_busy" not in codes:  # no answer comes from what is being loaded
                other.send_multipart([b"", *encode_request(ReadReg(("focus",)))])
                told = decode_reply(other.recv_multipart()[1:])
                codes.add(told.error.code if told.error else "")
            assert codes <= {"", "region_busy"}
        *_, told = (made.reply() for _ in range(4))
        assert isinstance(told.body, RegValues)
        assert [value.value for value in told.body.values] == [3]
        assert values(made, "focus") == [7]


# ---- life ----------------------------------------------------------------------------------------------


def test_the_configuration_named_at_the_start_is_loaded_and_known_after_a_restart(tmp_path: Path) -> None:
    with daemon(load="camera/colorise") as first:
        until(lambda: first.status.mode == "colorise" and not first.status.fpga_busy)
        folder, board = first.folder, first.board
        first.close()
        again = Daemon(folder, board)
        assert again.status.mode == "colorise"
        assert again.status.last_error is None
        again.close()


def test_what_the_start_asks_for_is_loaded_in_its_default_mode_or_there_is_no_start() -> None:
    with daemon(load="camera") as made:
        until(lambda: made.status.mode == "default" and not made.status.fpga_busy)
        made.close()
        with pytest.raises(UnknownMode, match="configuration 'camera' has no mode 'nothing'"):
            Daemon(made.folder / "other", made.board, load="camera/nothing")


def test_where_a_daemon_listens_is_logged_and_announced(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "cm")
    with daemon(listen=("tcp://127.0.0.1:0",)) as made:
        (tcp,) = json.loads((made.folder / "run/endpoints.json").read_text())["tcp"]
        assert f"listening on {tcp['pub']}, {tcp['sub']}, {tcp['req']}" in caplog.messages
    assert not (made.folder / "run/endpoints.json").exists()


def test_the_status_says_that_nothing_is_loaded(tmp_path: Path) -> None:
    with daemon() as fresh:
        assert fresh.status.config_name == ""
        assert fresh.refused(ReadReg(("focus",)))[0] == "nothing_loaded"
        assert fresh.refused(rq.ReadData("camera"))[0] == "nothing_loaded"
