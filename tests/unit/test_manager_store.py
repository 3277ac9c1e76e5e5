# SPDX-License-Identifier: Apache-2.0
"""The record: what was written whole is read again, whatever came after it."""

from __future__ import annotations

import os
import zlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import pytest

from cm.manager.cost import Throughput
from cm.manager.errors import StoreCorrupt
from cm.manager.state import BoardState, OverlayState, RegionPhase, RegionState
from cm.manager.store import Pending, Record, Store
from cm.schema.model import LoaderKind

FULL = Record(
    "boot",
    BoardState(
        config="camera",
        mode="edge",
        static_sha256="ab",
        static_config="whole",
        regions=MappingProxyType({"prr0": RegionState(RegionPhase.READY, "edge", "cd"), "prr1": RegionState()}),
        overlays=(OverlayState("base", "ef"), OverlayState("camera", "01")),
        values=MappingProxyType({"focus": 2**64 - 1}),
    ),
    Pending(7, "camera", "default", "camera", "edge", "load", "prr0", None, "whole"),
    Throughput(MappingProxyType({LoaderKind.ICAP: 123.5})),
    7,
)


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    made = Store(tmp_path)
    yield made
    made.close()


def test_nothing_is_read_before_anything_was_written(store: Store) -> None:
    assert store.read() is None


def test_a_record_comes_back_as_it_was(store: Store) -> None:
    lost = replace(FULL, state=BoardState(static_lost=True), pending=None)
    for record in (FULL, lost):
        store.write(record)
        assert store.read() == record


def test_a_torn_end_counts_for_nothing_wherever_it_is_torn(store: Store, tmp_path: Path) -> None:
    store.write(FULL)
    whole = (tmp_path / "journal").read_bytes()
    store.write(replace(FULL, number=8))
    both = (tmp_path / "journal").read_bytes()
    for length in range(len(whole), len(both) - 1):
        (tmp_path / "journal").write_bytes(both[:length])
        assert store.read() == FULL
    (tmp_path / "journal").write_bytes(both[:-5])
    again = Store(tmp_path)
    again.write(replace(FULL, number=9))  # after a torn end
    assert again.read() == replace(FULL, number=9)
    again.close()


def test_a_flipped_bit_is_noticed(store: Store, tmp_path: Path) -> None:
    store.write(FULL)
    line = bytearray((tmp_path / "journal").read_bytes())
    for at in range(1, len(line) - 1, 7):
        line[at] ^= 4
        (tmp_path / "journal").write_bytes(line)
        with pytest.raises(StoreCorrupt):
            store.read()
        assert (tmp_path / "journal.corrupt").read_bytes() == line
        line[at] ^= 4


def test_a_record_of_another_version_is_not_read_and_neither_are_those_before_it(store: Store, tmp_path: Path) -> None:
    store.write(FULL)
    body = b'{"version":99}'
    with (tmp_path / "journal").open("ab") as file:
        file.write(b"\n%08x %b\n" % (zlib.crc32(body), body))
    with pytest.raises(StoreCorrupt, match="another version"):
        store.read()
    assert store.read() is None
    store.write(FULL)
    assert store.read() == FULL


def test_the_journal_is_bounded_and_a_kill_while_it_is_replaced_loses_nothing(store: Store, tmp_path: Path) -> None:
    for number in range(1000):
        store.write(replace(FULL, number=number))
    assert (tmp_path / "journal").stat().st_size <= 256 * 1024
    (tmp_path / "journal.new").write_bytes(b"half")
    assert store.read() == replace(FULL, number=999)


def test_a_short_write_is_an_error(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    store.write(FULL)
    write = os.write
    monkeypatch.setattr(os, "write", lambda fd, data: write(fd, data[:-9]))
    with pytest.raises(OSError, match="whole"):
        store.write(replace(FULL, number=8))
    monkeypatch.undo()
    assert store.read() == FULL
