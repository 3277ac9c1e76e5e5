# SPDX-License-Identifier: Apache-2.0
"""How much one request may contain, and the error for more; docs/limits.md has the table."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest

import cm
from cm.errors import InvalidRequest
from cm.server.settings.model import LimitSettings
from cm.wire import bounds
from cm.wire import cm_pb2 as pb
from cm.wire.decode import decode_request
from cm.wire.messages.requests import ReadData, RegWrite, WriteReg
from cm.wire.text import in_slices

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
        (b"cm_write_reg", mapping(18_000), "too_long"),
        (b"cm_write_reg", b"{'a': 0x" + b"f" * 17 + b"}", "invalid_request"),
        (b"cm_write_reg", b"{'a': " + b"9" * 5000 + b"}", "invalid_request"),
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
    assert bounds.in_one_go(in_slices(text)).writes == tuple(RegWrite(name, value) for name, value in values.items())


WRONG = (
    b"{}", b"{", b"{'a'}", b"{'a': }", b"{'a': 1 'b': 2}", b"{'a': 1}}", b"{,}", b"{'a': 1.5}", b"{'a': -1}",
    b"{'a': 0x}", b"{a: 1}", b"{1: 1}", b"{'a': '1'}", b"\xff{",
)  # fmt: skip


@pytest.mark.parametrize("text", WRONG)
def test_what_is_not_a_mapping_of_integers_is_refused(text: bytes) -> None:
    with pytest.raises(InvalidRequest, match="cm_write_reg: "):
        bounds.in_one_go(in_slices(text))


def test_a_text_is_read_in_a_single_pass_whatever_it_contains(monkeypatch: pytest.MonkeyPatch) -> None:
    """Time is linear in its length: each entry is matched once, up to the first beyond the bound."""
    calls: list[int] = []
    check = bounds.check_count
    monkeypatch.setattr(bounds, "check_count", lambda *a: (calls.append(a[2]), check(*a)))
    with pytest.raises(bounds.TooMany):
        bounds.in_one_go(in_slices(mapping(5000)))
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


BEYOND = {  # what stands in the page, and the test of what happens beyond it
    "descriptors": "test_a_process_that_takes_up_the_descriptors_loses_its_connections",
    "bytes of one frame": "test_a_frame_of_a_gibibyte_and_a_half_is_refused_when_it_is_announced",
    "bytes of topics": "test_who_subscribes_to_thousands_of_topics_is_disconnected",
    "bytes of a message": "test_each_bound_has_an_error_of_its_own",
    "registers, writes": "test_each_bound_has_an_error_of_its_own",
    "bytes of a name": "test_each_bound_has_an_error_of_its_own",
    "nesting and values": "test_text_that_is_not_a_schema_is_refused",
    "reads and writes": "test_a_client_has_so_many_requests_under_way_and_gets_room_as_they_end",
    "bytes of these": "test_waiting_requests_are_bounded_for_one_client_and_for_all",
    "bytes of replies": "test_unread_answers_have_a_limit_in_bytes",
    "long requests": "test_so_many_jobs_of_a_user_wait_and_none_after_the_end",
    "requests that wait": "test_so_many_requests_of_a_sender_wait",
    "changes, and checks": "test_a_client_may_have_so_many_changes_and_checks_and_more_as_they_end",
    "bytes and number": "test_what_is_only_said_to_come_takes_no_room_of_others",
    "bytes of configurations": "test_quotas_per_sender_and_in_total_are_kept",
    "leases": "test_a_client_and_all_together_hold_no_more_leases_than_they_may",
    "connections that read": "test_a_user_has_so_many_and_one_more_goes_by_requests",
    "windows": "test_a_user_has_so_many_windows_and_all_have",
    "slots of a stream": "test_the_same_user_gets_no_more_by_asking_again_from_whatever_process",
    "bytes of memory": "test_the_processes_of_a_user_get_so_much_memory_in_so_many_pieces",
}


def test_the_page_has_every_bound_and_each_has_a_test() -> None:
    page = PAGE.read_text("utf-8").partition("## The loop's time")[0]
    told = dict(re.findall(r"^\| [^|]*\| ([^|]*?) \| ([^|]*?) \|", page, re.MULTILINE)[1:])
    assert told["bytes of a name"].startswith(f"{bounds.NAME_BYTES}; {bounds.LEASES_BYTES} ")
    listed = told["registers, writes and other things that one request lists"]
    assert listed == f"{bounds.ENTRIES}; {bounds.FILES} files"
    assert told["bytes of a message (second frame)"] == f"{bounds.MESSAGE_BYTES >> 10} KiB; with a schema 1152 KiB"
    assert bounds.WAIT_SECONDS == 86_400  # a day
    assert [next((key for key in BEYOND if what.startswith(key)), what) for what in told] == [*BEYOND]
    assert set(re.findall(r"`limits\.(\w+)` \|$", page, re.MULTILINE)) == set(LimitSettings.__match_args__)
    tests = "".join(path.read_text("utf-8") for path in Path(__file__).parents[2].rglob("test_*.py"))
    assert [name for name in BEYOND.values() if f"def {name}(" not in tests] == []
