# SPDX-License-Identifier: Apache-2.0
"""Requests: one class for each intent, each of which survives the wire and has a handler."""

from __future__ import annotations

import runpy
from hashlib import sha256
from pathlib import Path
from typing import Any, get_args

import pytest

from cm.errors import InvalidRequest
from cm.wire.cm_pb2 import DataConfig, File, Lease, ReadConfig, Region, WriteConfig, WriteData
from cm.wire.decode import decode_request, split_text
from cm.wire.encode import encode_request
from cm.wire.messages import requests as rq

CHANGE = rq.ChangeMode("camera", "edge", no_wait=True, no_queue=True, force=True, lease="l")
ALL: list[Any] = [
    rq.ReadStatus(),
    rq.ReadConfig("camera"),
    rq.ListConfigs(),
    rq.PlanChange("camera", "edge"),
    rq.PlanChange("camera"),
    rq.PlanChange(unload="prr0"),
    CHANGE,
    rq.ChangeMode(name_or_mode="edge"),
    rq.ChangeMode(unload=rq.WHOLE, lease="l"),
    rq.CancelChange(),
    rq.Provision("config: {}", (rq.File("a.bit", b"1", sha256=sha256(b"1").hexdigest()),)),
    rq.Provision("config: {}", change=rq.ChangeMode(mode="edge", force=True, lease="l"), lease="l"),
    rq.RemoveConfig("camera", "l"),
    rq.ReadReg(("focus", "led.blink")),
    rq.WriteReg((rq.RegWrite("focus", 2), rq.RegWrite("led", 1, mask=3)), "l"),
    rq.DescribeData("camera", "l"),
    rq.ConfigureStream(
        "camera",
        (2, 3),
        dtype="uint8",
        slots=4,
        direction="s2mm",
        rate=2.5,
        cyclic=False,
        enable=True,
        force=True,
        lease="l",
    ),
    rq.ConfigureStream("camera", backpressure=False, stride=8, automatic=True),
    rq.ConfigureStream("camera", enable=False),
    rq.DefineMemory("taps", 0x1000, length=64, shape=(4, 4), dtype="uint32", access="ro", region="static", lease="l"),
    rq.DefineMemory("taps", 0, length=4),
    rq.DefineMemory("taps", None, length=4),
    rq.ReadData("camera", 1.5),
    rq.ReadData("taps", offset=4, length=8),
    rq.WriteData("taps", b"1234", lease="l", offset=4),
    rq.BreakLease(3),
    rq.Upload("a", 10, offset=4, data=b"part"),
    rq.Upload("a", discard=True),
    rq.WriteData("s", upload="a"),
    rq.CheckRegion("prr0"),
    rq.MapRegion("prr0"),
    rq.CheckRegion("prr0", repair=True, reload=True, lease="l"),
    rq.ReadIrq("done"),
    rq.TakeLease("region:prr0", False, seconds=5.0, holder="anna", pid=7),
    rq.RenewLease("id", 5.0, pid=7),
    rq.ReleaseLease("id"),
]


def named(request: object) -> str:
    return type(request).__name__


@pytest.mark.parametrize("request_", ALL, ids=named)
def test_a_request_is_unchanged_after_the_wire(request_: Any) -> None:
    assert decode_request(encode_request(request_)) == request_


def test_every_intent_is_among_them() -> None:
    assert {type(request) for request in ALL} == set(get_args(rq.Request))


@pytest.mark.parametrize(
    ("topic", "message", "intent"),
    [
        (b"cm_write_config", WriteConfig(schema="s", provision_only=True, mode="edge"), rq.Provision("s")),
        (b"cm_data_config", DataConfig(stream="a", address=0), rq.DefineMemory("a", 0)),
        (
            b"cm_data_config",
            DataConfig(stream="a", dtype="int8", access="ro"),
            rq.DefineMemory("a", dtype="int8", access="ro"),
        ),
        (b"cm_data_config", DataConfig(stream="a", force=True), rq.ConfigureStream("a", force=True)),
        (b"cm_data_config", DataConfig(stream="a", cyclic=False), rq.ConfigureStream("a", cyclic=False)),
        # field 7 as written by clients without field presence: true is written, false is omitted
        (b"cm_data_config", DataConfig.FromString(b"\x0a\x01a\x38\x01"), rq.ConfigureStream("a", cyclic=True)),
        (b"cm_lease", Lease(id="a"), rq.RenewLease("a", 0.0)),
        (b"cm_lease", Lease(release=True), rq.ReleaseLease("")),
    ],
)
def test_a_message_is_the_request_whose_fields_it_has(topic: bytes, message: Any, intent: rq.Request) -> None:
    assert decode_request([topic, message.SerializeToString()]) == intent


@pytest.mark.parametrize(
    ("topic", "message", "said"),
    [
        (b"cm_read_config", ReadConfig(config_name="a", list=True), r"config_name, list .* ListConfigs \(list\)"),
        (
            b"cm_read_config",
            ReadConfig(plan_mode="edge"),
            r"plan_mode are .* PlanChange \(config_name, plan, plan_mode",
        ),
        (b"cm_write_config", WriteConfig(cancel=True, mode="edge"), r"cancel, mode are no request together"),
        (b"cm_write_config", WriteConfig(schema="s", unload="*"), r"schema, unload are no request together"),
        (
            b"cm_write_config",
            WriteConfig(config_name="a", mode="edge", remove=True),
            r"RemoveConfig \(config_name, lease",
        ),
        (b"cm_data_config", DataConfig(stream="a", access="ro", slots=3), "access, slots, stream are no request"),
        (b"cm_region", Region(name="left", map=True, repair=True), r"MapRegion \(map, name\)"),
        (b"cm_lease", Lease(id="a", scope="board"), r"RenewLease \(id, pid, seconds\)"),
        (b"cm_lease", Lease(id="a", number=3, release=True), r"BreakLease \(number, release\)"),
    ],
)
def test_fields_of_two_requests_in_one_message_are_refused(topic: bytes, message: Any, said: str) -> None:
    with pytest.raises(InvalidRequest, match=said):
        decode_request([topic, message.SerializeToString()])


@pytest.mark.parametrize(
    ("frames", "said"),
    [
        ([b"cm_nonsense", b""], "unknown topic"), ([b"cm_write_reg", b"\xff\xff\xff"], "not a WriteReg message"),
        ([b"cm_write_reg", b"{ 'focus': 'two' }"], "not an integer"), ([b"cm_write_reg", b""], "at least one"),
        ([b"cm_config", b"no such mode!"], "plain text"), ([b"cm_config", b""], "plain text"),
        ([b"cm_write_data", WriteData(stream="to_pl").SerializeToString()], "payload"),
    ],
)  # fmt: skip
def test_what_is_no_request_gets_a_clear_error(frames: list[bytes], said: str) -> None:
    with pytest.raises(InvalidRequest, match=said):
        decode_request(split_text(frames))


@pytest.mark.parametrize(
    ("request_", "said"),
    [
        (
            rq.ReadReg((["version"],)),
            r"ReadReg: each of its names is text, not \['version'\] \(list\); give them",
        ),  # type: ignore[arg-type]
        (rq.ReadReg((1,)), r"ReadReg: each of its names is text, not 1 \(int\)"),  # type: ignore[arg-type]
        (rq.WriteReg((rq.RegWrite(1, 2),)), r"WriteReg: name is text, not 1 \(int\)"),  # type: ignore[arg-type]
        (rq.ReadIrq(3), r"ReadIrq: name is text, not 3 \(int\)"),  # type: ignore[arg-type]
        (rq.ChangeMode("camera", 3), r"ChangeMode: mode is text, not 3 \(int\)"),  # type: ignore[arg-type]
    ],
)
def test_what_is_no_name_is_refused_in_words(request_: Any, said: str) -> None:
    with pytest.raises(InvalidRequest, match=said):
        encode_request(request_)


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ({"shape": ("x",)}, r"of 'camera': each of its shape is a whole number, not 'x' \(str\)$"),
        ({"slots": 1.5}, r"of 'camera': slots is a whole number, not 1.5 \(float\)$"),
        ({"slots": -1, "rate": 3.0}, "ConfigureStream of 'camera': slots=-1 is out of its range"),
        ({"rate": 3.0, "dtype": 5}, r"of 'camera': dtype is text, not 5 \(int\)$"),
    ],
)
def test_a_setting_that_cannot_be_is_named(setting: dict[str, Any], said: str) -> None:
    with pytest.raises(InvalidRequest, match=said):
        encode_request(rq.ConfigureStream("camera", **setting))


def test_a_place_before_a_memory_is_called_one() -> None:
    with pytest.raises(InvalidRequest, match="ReadData of 'taps': offset=-4 is out of its range"):
        encode_request(rq.ReadData("taps", offset=-4, length=8))


@pytest.mark.parametrize("change", [None, CHANGE], ids=["kept", "and loaded"])
def test_an_empty_schema_is_no_change_of_the_mode(change: rq.ChangeMode | None) -> None:
    with pytest.raises(InvalidRequest, match="the schema is empty"):
        encode_request(rq.Provision("", change=change))
    for message in (WriteConfig(provision_only=True), WriteConfig(files=[File(name="a.bit", upload="u")], mode="edge")):
        with pytest.raises(InvalidRequest, match="the schema to be provisioned is empty"):
            decode_request([b"cm_write_config", message.SerializeToString()])


def test_the_page_has_the_table_as_it_is() -> None:
    docs = Path(__file__).parents[3] / "docs"
    page, maker = (docs / "protocol.md").read_text(encoding="utf-8"), runpy.run_path(str(docs / "request_tables.py"))
    assert maker["page"](page) == page, "run: python docs/request_tables.py"
