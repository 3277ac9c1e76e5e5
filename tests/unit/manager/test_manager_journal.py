# SPDX-License-Identifier: Apache-2.0
"""The record: what was written completely is read again, whatever follows it."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import gc
import os
import subprocess
import zlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import pytest

from cm.manager.errors import StateInUse, StoreCorrupt
from cm.manager.state.board_state import BoardState, OverlayState, RegionPhase, RegionState
from cm.manager.state.journal import (
    LENGTH,
    Damaged,
    Journal,
    OtherVersion,
    Pending,
    Record,
    Throughput,
    WayBack,
    newest,
)
from cm.schema.model import LoaderKind, Region

FULL = Record(
    "boot",
    BoardState(
        config="camera",
        mode="edge",
        schema="12",
        static_sha256="ab",
        static_config="whole",
        regions=MappingProxyType({"prr0": RegionState(RegionPhase.READY, "edge", "cd"), "prr1": RegionState()}),
        overlays=(OverlayState("base", "ef"), OverlayState("camera", "01")),
        values=MappingProxyType({"focus": 2**64 - 1}),
        clocks=MappingProxyType({"fclk0": 99_999_999}),
    ),
    Pending(
        7,
        "camera",
        "default",
        "camera",
        "edge",
        "load",
        "prr0",
        "base",
        "whole",
        held={"prr0": "edge"},
        values={"focus": 3},
        found=((0x1018, 32, 4), (0x101C, 8, 5)),
        rates={"fclk0": 50_000_000},
        touched=True,
        begun=("prr0",),
    ),
    Throughput(MappingProxyType({LoaderKind.ICAP: (123.5, 99.0)}), MappingProxyType({"load": (0.5,)})),
    7,
)
UNDOABLE = WayBack("c1", replace(FULL.pending, number=6, overlay=None, step="", subject=""))  # type: ignore[type-var]


@pytest.fixture
def journal(tmp_path: Path) -> Iterator[Journal]:
    made = Journal(tmp_path)
    yield made
    made.close()


def lines(folder: Path) -> bytes:
    """The records in the file; the rest is space for more."""
    return (folder / "journal").read_bytes().rstrip(b"\0")


def test_nothing_is_read_before_anything_was_written_in_a_folder_that_is_made(tmp_path: Path) -> None:
    journal = Journal(tmp_path / "state" / "of" / "cm")
    assert journal.read() is None
    journal.close()


def test_a_record_comes_back_as_it_was(journal: Journal) -> None:
    lost = replace(FULL, state=BoardState(static_lost=True), pending=None)
    for record in (FULL, lost, replace(FULL, way_back=UNDOABLE), replace(lost, way_back=UNDOABLE), FULL):
        journal.write(record)
        assert journal.read() == record


def test_a_record_torn_anywhere_is_ignored(journal: Journal, tmp_path: Path) -> None:
    journal.write(FULL)
    whole = lines(tmp_path)
    journal.write(replace(FULL, number=8))
    both = lines(tmp_path)
    for length in range(len(whole), len(both) - 1):
        (tmp_path / "journal").write_bytes(both[:length].ljust(LENGTH, b"\0"))
        assert journal.read() == FULL
    (tmp_path / "journal").write_bytes(both[:-5].ljust(LENGTH, b"\0"))
    journal.close()
    again = Journal(tmp_path)
    again.write(replace(FULL, number=9))  # after a torn end
    assert again.read() == replace(FULL, number=9)
    again.close()


def test_a_journal_that_was_cut_off_is_not_believed_wherever_that_was(journal: Journal, tmp_path: Path) -> None:
    for number in range(3):
        journal.write(replace(FULL, number=number))
    whole = lines(tmp_path)
    journal.close()
    for length in (1, len(whole) // 3, len(whole) // 3 + 1, len(whole) - 1, len(whole), LENGTH - 1):
        (tmp_path / "journal").write_bytes(whole.ljust(LENGTH, b"\0")[:length])
        again = Journal(tmp_path)
        with pytest.raises(StoreCorrupt, match="cut off at its end, so what it said last is not known; it was moved"):
            again.read()
        assert again.read() is None
        again.write(FULL)
        assert again.read() == FULL
        again.close()


def test_a_damaged_line_is_not_passed_over_for_the_one_before_it(journal: Journal, tmp_path: Path) -> None:
    journal.write(FULL)
    first = len(lines(tmp_path))
    journal.write(replace(FULL, number=8))
    both = lines(tmp_path)
    for at in range(first + 1, len(both) - 1, 5):
        bad = bytearray(both.ljust(LENGTH, b"\0"))
        bad[at] ^= 4
        with pytest.raises(Damaged):
            newest(bytes(bad))


def test_a_line_that_is_nested_without_end_is_no_record() -> None:
    body = b'{"version":' + b"[" * 100_000
    with pytest.raises(OtherVersion):
        newest(b"\n%08x %b\n" % (zlib.crc32(body), body))


def test_a_spare_journal_that_was_cleared_in_part_is_not_used(
    journal: Journal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An older line would stand behind the newest one, and be believed."""
    write = os.pwrite

    def half(descriptor: int, data: bytes, at: int) -> int:
        return write(descriptor, data[: len(data) // 2] if len(data) == LENGTH else data, at)

    monkeypatch.setattr(os, "pwrite", half)
    for number in range(1200):
        journal.write(replace(FULL, number=number))
        assert journal.read() == replace(FULL, number=number)


def test_a_flipped_bit_is_noticed(journal: Journal, tmp_path: Path) -> None:
    journal.write(FULL)
    line = bytearray(lines(tmp_path))
    for at in range(1, len(line) - 1, 7):
        line[at] ^= 4
        (tmp_path / "journal").write_bytes(line)
        with pytest.raises(StoreCorrupt):
            journal.read()
        assert (tmp_path / "journal.corrupt").read_bytes() == line
        line[at] ^= 4


def test_a_record_of_another_version_is_not_read_and_neither_are_those_before_it(
    journal: Journal, tmp_path: Path
) -> None:
    journal.write(FULL)
    body = b'{"version":99}'
    with (tmp_path / "journal").open("ab") as file:
        file.write(b"\n%08x %b\n" % (zlib.crc32(body), body))
    moved = f"it was moved to {tmp_path / 'journal.corrupt'}"
    with pytest.raises(StoreCorrupt) as refused:
        journal.read()
    assert str(refused.value) == (
        f"the state record {tmp_path / 'journal'} is of another version of this program; {moved}"
    )
    (tmp_path / "journal").write_bytes(b"\nrubbish")
    with pytest.raises(StoreCorrupt) as refused:
        journal.read()
    lost = "is damaged or cut off at its end, so what it said last is not known"
    assert str(refused.value) == f"the state record {tmp_path / 'journal'} {lost}; {moved}"
    assert journal.read() is None
    journal.write(FULL)
    assert journal.read() == FULL


def test_the_journal_is_bounded_and_a_kill_while_it_is_replaced_loses_nothing(journal: Journal, tmp_path: Path) -> None:
    for number in range(1000):
        journal.write(replace(FULL, number=number))
    assert (tmp_path / "journal").stat().st_size <= 256 * 1024
    (tmp_path / "journal.new").write_bytes(b"half")
    assert journal.read() == replace(FULL, number=999)


def test_a_short_write_is_an_error_and_the_next_one_takes_its_place(
    journal: Journal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    journal.write(FULL)
    write = os.pwrite
    for torn in (9, 100, 1):
        with monkeypatch.context() as patch:
            patch.setattr(os, "pwrite", lambda fd, data, at, torn=torn: write(fd, data[:-torn], at))
            with pytest.raises(OSError, match=f"it was not written whole: is the disk full.: '{tmp_path}/journal'"):
                journal.write(replace(FULL, number=8))
        assert journal.read() == FULL
    small = Record("boot", BoardState(), number=9)
    journal.write(small)
    assert journal.read() == small


def test_a_second_manager_with_the_same_state_folder_is_refused(journal: Journal, tmp_path: Path) -> None:
    with pytest.raises(StateInUse) as refused:
        Journal(tmp_path)
    assert str(refused.value) == (
        f"another configuration manager keeps its state in {tmp_path}; stop it, or choose another --state-dir"
    )
    journal.write(FULL)
    journal.close()
    journal.close()
    again = Journal(tmp_path)
    assert again.read() == FULL
    again.close()


def test_one_disturbed_measurement_does_not_change_the_estimate() -> None:
    known = Throughput()
    nominal = known.seconds(LoaderKind.ICAP, 4_000_000)
    for seconds in (0.900, 0.021, 0.020, 0.022, 0.700, 0.020):
        known = known.observed(LoaderKind.ICAP, 4_000_000, seconds).took(("load", seconds))
        expected = known.seconds(LoaderKind.ICAP, 4_000_000)
        assert expected == nominal if seconds == 0.900 else expected == pytest.approx(0.021, rel=0.05)
    assert known.overhead("load") == 0.021
    for _ in range(5):
        known = known.observed(LoaderKind.ICAP, 4_000_000, 0.5).took(("load", 0.5))
    assert (known.seconds(LoaderKind.ICAP, 4_000_000), known.overhead("load")) == (0.5, 0.5)


def test_a_load_counts_as_hung_after_what_the_schema_says_or_twenty_times_what_is_expected() -> None:
    known = Throughput().observed(LoaderKind.ICAP, 100, 0.0).observed(LoaderKind.ICAP, 0, 1.0)
    assert known == Throughput()  # nothing was measured
    assert known.observed(LoaderKind.ICAP, 1, 4.0).measured == {LoaderKind.ICAP: (0.25,)}
    for kind, rate in ((LoaderKind.ICAP, 400e6), (LoaderKind.FPGA_MANAGER, 145e6), (LoaderKind.OVERLAY, 145e6)):
        assert known.timeout(Region("prr0", loader=kind), 4_000_000) == 2.0 + 20.0 * (4_000_000 / rate)
    assert known.timeout(Region("prr0", timeout=0.5), 4_000_000) == 0.5
    two = known.observed(LoaderKind.ICAP, 100, 1.0).observed(LoaderKind.ICAP, 123_456, 2.0)
    assert two.measured == {LoaderKind.ICAP: (100.0, 61_730.0)}  # four digits are recorded
    assert two.rate(LoaderKind.ICAP) == 61_730.0
    assert (
        known.observed(LoaderKind.ICAP, 500, 1e-6).observed(LoaderKind.ICAP, 600, 1e-6).rate(LoaderKind.ICAP) == 600e6
    )
    assert (two.took(("load", 3.0), ("load", 2.0)).overhead("load"), two.overhead("load")) == (2.0, 0.0)


def test_an_unreadable_record_is_reported(journal: Journal, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(_: Path) -> bytes:
        raise OSError(errno.EIO, "broken card")

    journal.write(FULL)
    with monkeypatch.context() as patch:
        patch.setattr(Path, "read_bytes", fails)
        with pytest.raises(StoreCorrupt, match="broken card"):
            journal.read()


def test_a_bad_record_on_a_read_only_file_system_is_no_more_than_bad(
    journal: Journal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*_: object) -> Path:
        raise OSError(errno.EROFS, "read-only")

    (tmp_path / "journal").write_bytes(b"rubbish")
    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", fails)
        with pytest.raises(StoreCorrupt, match=r"is not known; it could not be set aside \(.*read-only"):
            journal.read()


def test_no_descriptor_goes_astray_when_the_journal_cannot_be_replaced(
    journal: Journal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A descriptor that is no longer ours may belong to a device by the next write."""

    def fails(*_: object) -> Path:
        raise OSError(errno.EROFS, "read-only")

    before = descriptors()
    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", fails)
        failures = sum(not written(journal, number) for number in range(1500))
    assert failures > 500
    assert descriptors() == before
    assert written(journal, 4711)
    assert journal.read() == replace(FULL, number=4711)
    assert descriptors() == before


def test_a_disk_without_room_for_the_next_journal_is_tried_again_when_that_is_needed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened = os.open

    def no_room(path: Path, *rest: int) -> int:
        if str(path).endswith(".new"):
            raise OSError(errno.ENOSPC, "full")
        return opened(path, *rest)

    with monkeypatch.context() as patch:
        patch.setattr(os, "open", no_room)
        journal = Journal(tmp_path)
    before = descriptors()
    for number in range(1000):
        journal.write(replace(FULL, number=number))
    assert journal.read() == replace(FULL, number=999)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["journal", "journal.new"]
    assert descriptors() == before + 1  # the spare one, from now on
    journal.close()
    assert descriptors() == before - 2


def test_a_journal_that_cannot_be_opened_keeps_no_folder_locked(tmp_path: Path) -> None:
    (tmp_path / "journal").symlink_to(tmp_path / "elsewhere")
    before = descriptors()
    for _ in range(2):
        with pytest.raises(OSError, match="symbolic links"):
            Journal(tmp_path)
    assert descriptors() == before


def test_a_lock_that_fails_for_another_reason_is_that_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object) -> None:
        raise OSError(errno.ENOLCK, "no locks here")

    before = descriptors()
    monkeypatch.setattr(fcntl, "flock", fails)
    with pytest.raises(OSError, match="no locks here"):
        Journal(tmp_path)
    assert descriptors() == before


def written(journal: Journal, number: int) -> bool:
    try:
        journal.write(replace(FULL, number=number))
    except OSError:
        return False
    return True


def descriptors() -> int:
    gc.collect()  # what other tests left to it has some
    return len(list(Path("/proc/self/fd").iterdir()))


def fill(disk: Path) -> None:
    with contextlib.suppress(OSError), (disk / "log").open("ab", buffering=0) as file:
        while True:
            file.write(bytes(4096))


@pytest.mark.programs
def test_a_disk_that_others_fill_does_not_stop_the_record(small_disk: Path) -> None:
    journal = Journal(small_disk / "state")
    for number in range(2000):  # more than three new journals
        fill(small_disk)
        journal.write(replace(FULL, number=number))
    assert journal.read() == replace(FULL, number=1999)
    assert sorted(p.name for p in (small_disk / "state").iterdir()) == ["journal", "journal.new"]
    journal.close()
    again = Journal(small_disk / "state")
    assert again.read() == replace(FULL, number=1999)
    for number in range(1000):
        fill(small_disk)
        again.write(replace(FULL, number=number))
    again.close()


@pytest.mark.programs
def test_a_disk_that_became_read_only_is_read_and_says_so_when_it_is_to_be_written(small_disk: Path) -> None:
    first = Journal(small_disk / "state")
    first.write(FULL)
    first.close()
    subprocess.run(["mount", "-o", "remount,ro", small_disk], check=True)
    journal = Journal(small_disk / "state")
    assert journal.read() == FULL
    for _ in range(2):
        with pytest.raises(OSError, match=r"Read-only file system: '.*/state/journal'"):
            journal.write(replace(FULL, number=8))
    subprocess.run(["mount", "-o", "remount,rw", small_disk], check=True)
    journal.write(replace(FULL, number=9))
    assert journal.read() == replace(FULL, number=9)
    journal.close()


@pytest.mark.programs
def test_a_disk_that_was_full_before_is_an_error_until_there_is_room(small_disk: Path) -> None:
    fill(small_disk)
    journal = Journal(small_disk / "state")
    with pytest.raises(OSError, match="No space"):
        journal.write(FULL)
    assert journal.read() is None
    (small_disk / "log").unlink()
    journal.write(FULL)
    assert journal.read() == FULL
    journal.close()
