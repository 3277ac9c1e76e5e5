# SPDX-License-Identifier: Apache-2.0
"""How much one request may contain, and the error for more; docs/limits.md has the table."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest

import cm
from cm.errors import InvalidRequest
from cm.wire import bounds
from cm.wire import cm_pb2 as pb
from cm.wire.decode import decode_request
from cm.wire.messages.requests import ReadData, RegWrite, WriteReg
from cm.wire.text import parse_registers

PAGE = Path(cm.__file__).resolve().parents[1] / "docs" / "limits.md"


def code_of(topic: bytes, message: bytes) -> str:
    with pytest.raises(InvalidRequest) as caught:
        decode_request([topic, message])
    assert len(str(caught.value)) < 1000
    return caught.value.code


def writes(count: int) -> bytes:
    return pb.WriteReg(writes=[pb.RegWrite(name="a", value=1)] * count).SerializeToString()


def mapping(count: int) -> bytes:
    return b"{" + b",".join(b"'r%d':1" % i for i in range(count)) + b"}"


@pytest.mark.parametrize(
    ("topic", "message", "code"),
    [
        (b"cm_write_reg", writes(100_000), "too_long"),
        (b"cm_write_reg", writes(bounds.ENTRIES + 1), "too_many"),
        (b"cm_write_reg", mapping(bounds.ENTRIES + 1), "too_many"),
        (b"cm_write_reg", mapping(9000), "too_long"),
        (b"cm_write_reg", b"{'a': 0x" + b"f" * 5000 + b"}", "number_too_long"),
        (b"cm_write_reg", b"{'a': " + b"9" * 5000 + b"}", "number_too_long"),
        (b"cm_write_reg", b"{'" + b"a" * 60_000 + b"': 1}", "name_too_long"),
        (b"cm_write_reg", b"{" * 60_000, "invalid_request"),
        (b"cm_write_reg", b"{'a':" + b"(" * 60_000, "invalid_request"),
        (b"cm_write_reg", b"{'a':" + b"{'a':" * 10_000, "invalid_request"),
        (b"cm_read_reg", pb.ReadReg(names=[""] * 60_000).SerializeToString(), "too_many"),
        (b"cm_read_reg", pb.ReadReg(names=["a" * 60_000]).SerializeToString(), "name_too_long"),
        (b"cm_data_config", pb.DataConfig(stream="s", shape=[1] * 2000).SerializeToString(), "too_many"),
        (b"cm_lease", pb.Lease(scope="board", holder="h" * 300).SerializeToString(), "name_too_long"),
        (b"cm_write_config", pb.WriteConfig(files=[pb.File()] * 300).SerializeToString(), "too_many"),
        (b"cm_write_config", pb.WriteConfig(schema="x" * (3 << 19)).SerializeToString(), "too_long"),
        (b"cm_write_config", pb.WriteConfig(mode="m" * 300).SerializeToString(), "name_too_long"),
    ],
)
def test_each_bound_has_an_error_of_its_own(topic: bytes, message: bytes, code: str) -> None:
    assert code_of(topic, message) == code


def test_requests_of_the_maximum_length_are_accepted() -> None:
    for message in (writes(bounds.ENTRIES), mapping(bounds.ENTRIES)):
        request = decode_request([b"cm_write_reg", message])
        assert isinstance(request, WriteReg)
        assert len(request.writes) == bounds.ENTRIES


@pytest.mark.parametrize(
    ("text", "values"),
    [
        (b"{ 'focus':0x2}", {"focus": 2}),
        (b'{"a": 1, "b.c": true, \'d\': False,}', {"a": 1, "b.c": 1, "d": 0}),
        (b"{\n 'a' : 0b11 ,\n 'b':0o17, 'c': 1_000}", {"a": 3, "b": 15, "c": 1000}),
        (b"{'a': 0x" + b"0" * 40_000 + b"f}", {"a": 15}),
        (b"{'a': 18446744073709551615}", {"a": (1 << 64) - 1}),
    ],
)
def test_a_mapping_is_read_as_python_and_json_spell_it(text: bytes, values: dict[str, int]) -> None:
    assert parse_registers(text).writes == tuple(RegWrite(name, value) for name, value in values.items())


WRONG = (
    b"{}", b"{", b"{'a'}", b"{'a': }", b"{'a': 1 'b': 2}", b"{'a': 1}}", b"{,}", b"{'a': 1.5}", b"{'a': -1}",
    b"{'a': 0x}", b"{a: 1}", b"{1: 1}", b"{'a': '1'}", b"\xff{",
)  # fmt: skip


@pytest.mark.parametrize("text", WRONG)
def test_what_is_not_a_mapping_of_integers_is_refused(text: bytes) -> None:
    with pytest.raises(InvalidRequest, match="cm_write_reg: "):
        parse_registers(text)


def test_a_text_is_read_in_a_single_pass_whatever_it_contains(monkeypatch: pytest.MonkeyPatch) -> None:
    """Time is linear in its length: each entry is matched once, up to the first beyond the bound."""
    calls: list[int] = []
    check = bounds.check_count
    monkeypatch.setattr(bounds, "check_count", lambda *a: (calls.append(a[2]), check(*a)))
    with pytest.raises(bounds.TooMany):
        parse_registers(mapping(5000))
    assert calls == list(range(1, bounds.ENTRIES + 2))


@pytest.mark.parametrize("given", [math.nan, -1.0, -math.inf])
def test_a_manager_refuses_what_is_no_time(given: float) -> None:
    """One that is not a number would end it: there is no number of milliseconds until then."""
    with pytest.raises(InvalidRequest, match="time-out"):
        decode_request([b"cm_read_data", pb.ReadData(stream="camera", timeout=given).SerializeToString()])


@pytest.mark.parametrize("given", [math.inf, 1e300])
def test_a_manager_waits_for_a_frame_for_a_day_at_most(given: float) -> None:
    message = pb.ReadData(stream="camera", timeout=given).SerializeToString()
    assert decode_request([b"cm_read_data", message]) == ReadData("camera", bounds.WAIT_SECONDS)


def test_the_page_has_every_bound() -> None:
    page = PAGE.read_text("utf-8")
    told = dict(re.findall(r"^\|[^|]*\| ([^|]*?) \| ([^|]*?) \| `[a-z_]+` \|", page, re.MULTILINE))
    assert told["bytes of a name"] == str(bounds.NAME_BYTES)
    assert told["registers, writes and other things that one request lists"] == str(bounds.ENTRIES)
    assert told["files of a configuration"] == str(bounds.FILES)
    assert told["bytes of a message (second frame)"] == f"{bounds.MESSAGE_BYTES >> 10} KiB; with a schema 1152 KiB"
    assert "| seconds that a request waits for a frame | 86,400;" in page
    assert bounds.WAIT_SECONDS == 86_400
    assert told["bytes of a text mapping"] == f"{bounds.TEXT_BYTES >> 10} KiB"
