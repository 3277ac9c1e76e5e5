# SPDX-License-Identifier: Apache-2.0
"""Regions are compared and put right in the background, as the settings say."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from manager_process import served, until

import cm
from cm.simulation.software import Board as SimBoard
from cm.wire.messages.status import RegionHealth

SCHEMA = """
config:
  name: one
  device: xc7z020
  regions: {only: {}}
  modules: {plain: {region: only}, careful: {region: only}}
  modes: {default: {modules: [plain]}, safe: {modules: [careful]}}
"""


@contextmanager
def scrubbed(folder: Path, policy: str, region: str = "only") -> Iterator[tuple[cm.Board, SimBoard]]:
    (folder / "one.yaml").write_text(SCHEMA)
    settings = folder / "cm.yaml"
    settings.write_text(f"scrub: {{{region}: {{every: 100ms, budget: 50 %, policy: {policy}}}}}\n")
    with (
        served(schemas=folder / "one.yaml", arguments=["--settings", str(settings)]) as (manager, sim),
        manager.connected() as board,
    ):
        board.load("one", "default")
        yield board, sim


def health(board: cm.Board) -> RegionHealth:
    (region,) = board.status.regions
    return region.health or RegionHealth()


@pytest.mark.parametrize("policy", ["repair", "reload"])
def test_an_upset_is_found_and_repaired_without_being_asked(tmp_path: Path, policy: str) -> None:
    with scrubbed(tmp_path, policy) as (board, sim):
        until(lambda: health(board).checks >= 2)
        assert health(board).upsets == 0
        for number in range(1, 4):
            sim.control.upset("only")
            until(lambda wanted=number: health(board).repairs == wanted)  # type: ignore[misc]
            assert board.check_region("only").verdict == "good"
        assert health(board).upsets == 3
        assert board.mode == "default"
        sim.control.inject("icap_write_only")  # a port that cannot be read is logged, and everything else goes on
        before = health(board).checks
        board.load("one", "safe")
        sim.control.clear()
        until(lambda: health(board).checks > before)
        assert board.mode == "safe"


def test_the_safe_mode_is_entered_where_that_is_the_policy(tmp_path: Path) -> None:
    with scrubbed(tmp_path, "safe") as (board, sim):
        sim.control.upset("only")
        until(lambda: board.mode == "safe")
        assert board.check_region("only").verdict == "good"


def test_what_is_wrong_is_only_told_where_that_is_the_policy_and_counted_once(tmp_path: Path) -> None:
    with scrubbed(tmp_path, "tell") as (board, sim):
        sim.control.upset("only", 2)
        until(lambda: health(board).wrong_bits == 2)
        before = health(board).checks
        until(lambda: health(board).checks >= before + 2)
        assert health(board).upsets == 2
        assert board.check_region("only", repair=True).wrong_bits == 2
        assert health(board).wrong_bits == 0
