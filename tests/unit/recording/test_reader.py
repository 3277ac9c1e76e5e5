# SPDX-License-Identifier: Apache-2.0
"""Records are read as far as they go, and nothing that is damaged is shown as data."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("mcap", reason="records need mcap")
from recording_support import BEGAN, OPENED, write_record

from cm.errors import InvalidRequest
from cm.recording.layout import file_name
from cm.recording.reader import Record
from cm.wire import cm_pb2 as pb
from cm.wire.messages.status import Irq, Status
from cm.wire.records import FrameSeen

pytestmark = pytest.mark.networks
EVENTS = [(float(n), "cm_irq", Irq("zz_irq", n, n)) for n in range(8)]


def counts(record: Record) -> list[int]:
    return [event.value.count for event in record.events() if event.topic == "cm_irq"]


def test_events_come_with_their_time_in_the_order_of_time(tmp_path: Path) -> None:
    late = [EVENTS[0], EVENTS[2], EVENTS[1], (2.5, "cm_status", Status("camera", "edge"))]
    record = Record(write_record(tmp_path / "a.mcap", late))
    assert record.opened == OPENED
    events = list(record.events())
    assert [(e.time_ns - BEGAN) / 1e9 for e in events] == [0.0, 1.0, 2.0, 2.5]
    assert events[-1].value == Status("camera", "edge")
    assert record.problems == []


def test_what_is_not_wanted_is_left_out_and_frames_have_their_data(tmp_path: Path) -> None:
    frame = pb.FrameSeen(frame=pb.Frame(stream="camera", sequence=3, shape=[2, 2]), kept=True)
    made = [(0.0, "cm_frame/camera", frame), (0.0, "cm_stream/camera", b"1234"), *EVENTS]
    record = Record(write_record(tmp_path / "a.mcap", made))
    seen, data = record.events(lambda topic: topic.endswith("/camera"))
    assert isinstance(seen.value, FrameSeen)
    assert (seen.value.frame.sequence, seen.value.frame.shape, seen.value.kept) == (3, (2, 2), True)
    assert data.value == b"1234"


def test_several_files_are_read_as_one_record(tmp_path: Path) -> None:
    write_record(tmp_path / "a.mcap", EVENTS[:3])
    write_record(file_name(tmp_path / "a.mcap", 2), EVENTS[3:])
    assert counts(Record(tmp_path / "a.mcap")) == list(range(8))


def test_a_record_cut_at_any_byte_gives_what_is_whole_and_says_that_its_end_is_missing(tmp_path: Path) -> None:
    whole = write_record(tmp_path / "whole.mcap", EVENTS, finish=False).read_bytes()
    cut, given = tmp_path / "cut.mcap", []
    for length in range(len(whole) // 4, len(whole), 7):
        cut.write_bytes(whole[:length])
        record = Record(cut)
        there = counts(record)
        assert there == list(range(len(there)))
        assert any("its recorder was killed" in text for text in record.problems), (length, record.problems)
        given.append(len(there))
    assert given == sorted(given)
    assert {3, 7} <= set(given)


def test_one_flipped_bit_is_told_and_never_shown_as_data(tmp_path: Path) -> None:
    whole = write_record(tmp_path / "whole.mcap", EVENTS).read_bytes()
    first, end = whole.index(b"zz_irq") - 200, whole.rindex(b"zz_irq")
    flipped, silent, less, flips = tmp_path / "flipped.mcap", [], 0, 0
    for at in range(first, end, 3):
        for bit in (0, 5) if at % 2 else (1, 6):
            flipped.write_bytes(whole[:at] + bytes([whole[at] ^ 1 << bit]) + whole[at + 1 :])
            try:
                record = Record(flipped)
                there = counts(record)
            except InvalidRequest:  # nothing at all is shown
                continue
            finally:
                flips += 1
            assert set(there) <= set(range(8)), (at, bit)
            less += len(there) < 8
            if not record.problems and there != list(range(8)):  # an index between chunks is no data
                silent.append((at, bit))
    assert flips > 300
    assert less > 150
    assert silent == []


def test_a_damaged_chunk_does_not_hide_those_behind_it(tmp_path: Path) -> None:
    path = write_record(tmp_path / "a.mcap", EVENTS)
    whole = path.read_bytes()
    at = whole.index(b"zz_irq", whole.index(b"zz_irq") + 1)
    path.write_bytes(whole[:at] + b"Z" + whole[at + 1 :])
    record = Record(path)
    gaps = [event.value for event in record.events() if event.topic == "cm_gap"]
    assert counts(record) == [0, *range(2, 8)]
    assert [gap.cause for gap in gaps] == ["damaged"]
    assert "nothing of it is shown" in gaps[0].text


def test_where_the_first_chunk_is_damaged_the_summary_says_what_the_others_hold(tmp_path: Path) -> None:
    path = write_record(tmp_path / "a.mcap", EVENTS)
    whole = path.read_bytes()
    at = whole.index(b"zz_irq")
    path.write_bytes(whole[:at] + b"Z" + whole[at + 1 :])
    record = Record(path)
    assert counts(record) == list(range(1, 8))
    assert len(record.problems) == 1


@pytest.mark.parametrize("content", [b"", b"\x89MCAP0\r\n", b"config: {}\n"])
def test_what_is_no_record_is_refused_by_its_name(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "no.mcap"
    path.write_bytes(content)
    with pytest.raises(InvalidRequest, match=r"no\.mcap: it is no record of cm record"):
        Record(path)
