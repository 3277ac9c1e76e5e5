# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import os
from pathlib import Path
from typing import BinaryIO

import pytest
from bitstream_support import small

import cm.formats.bitstream.report_cache as cache_module
from cm.formats.bitstream import ReportCache, inspect
from cm.formats.bitstream.container import read_bitstream


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Lengths of the files that were really inspected."""
    seen: list[int] = []

    def counting(data: bytes) -> object:
        seen.append(len(data))
        return inspect(data)

    monkeypatch.setattr(cache_module, "inspect", counting)
    return seen


def test_a_file_that_did_not_change_is_inspected_once_under_all_its_names(tmp_path: Path, counted: list[int]) -> None:
    path, link = tmp_path / "a.bit", tmp_path / "b.bit"
    path.write_bytes(small())
    os.link(path, link)
    cache = ReportCache()
    assert cache.inspect(path) == cache.inspect(path) == cache.inspect(link) == inspect(small())
    assert len(counted) == 1


@pytest.mark.parametrize("written", ["new", "a.bit"])
def test_a_file_that_was_replaced_or_changed_is_read_again_even_with_its_old_time(tmp_path: Path, written: str) -> None:
    path, other = tmp_path / "a.bit", tmp_path / written
    path.write_bytes(small(design="one"))
    stamp, cache = path.stat(), ReportCache()
    assert cache.inspect(path).design == "one"
    other.write_bytes(small(design="two"))
    os.utime(other, ns=(stamp.st_atime_ns, stamp.st_mtime_ns))
    other.replace(path)
    assert cache.inspect(path).design == "two"


def test_cache_forgets_the_least_recently_used(tmp_path: Path, counted: list[int]) -> None:
    paths = [tmp_path / f"{index}.bit" for index in range(3)]
    cache = ReportCache(capacity=2)
    for index, path in enumerate(paths):
        path.write_bytes(small(design=f"d{index}"))
        cache.inspect(path)
    cache.inspect(paths[1])
    assert len(counted) == 3
    cache.inspect(paths[0])  # 2, which was not used since, goes
    assert len(counted) == 4
    cache.inspect(paths[1])
    assert len(counted) == 4
    assert cache.known(paths[2]) is None


@pytest.mark.parametrize(("changes", "kept"), [(0, True), (2, True), (3, False)])
def test_a_file_that_is_written_while_it_is_read_is_read_thrice_and_not_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, changes: int, kept: bool
) -> None:
    path, left = tmp_path / "a.bit", list(range(changes))

    def reading(file: BinaryIO) -> bytes:
        data = read_bitstream(file)
        if left:
            path.write_bytes(small(design="d" * (20 - left.pop())))
        return data

    path.write_bytes(small())
    monkeypatch.setattr(cache_module, "read_bitstream", reading)
    cache = ReportCache()
    found = cache.read(path)
    assert found.report == inspect(found.data)
    assert cache.known(path) == (found.report if kept else None)
