# SPDX-License-Identifier: Apache-2.0
"""Regions are compared and put right in the background, as the settings say."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from daemon_thread import Daemon, daemon
from manager_process import until
from scraping import scrape

from cm.server.settings.model import ScrubSettings
from cm.wire.messages.requests import ChangeMode, CheckRegion
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
def scrubbed(folder: Path, policy: str) -> Iterator[Daemon]:
    (folder / "one.yaml").write_text(SCHEMA)
    scrub = {"only": ScrubSettings(every=0.1, budget=0.5, policy=policy), "gone": ScrubSettings(every=0.1)}
    with daemon(schemas=folder, scrub=scrub, metrics="0") as made:
        made.done(ChangeMode("one", "default"))
        yield made


def health(daemon: Daemon) -> RegionHealth:
    (region,) = daemon.status.regions
    return region.health or RegionHealth()


@pytest.mark.parametrize(("policy", "loads", "repairs"), [("repair", 1, 3), ("reload", 4, 0)])
def test_an_upset_is_found_and_repaired_without_being_asked(
    tmp_path: Path, policy: str, loads: int, repairs: int
) -> None:
    with scrubbed(tmp_path, policy) as daemon:
        until(lambda: health(daemon).checks >= 2)
        assert health(daemon).upsets == 0
        for number in range(1, 4):
            daemon.board.control.upset("only")
            until(lambda wanted=number: health(daemon).repairs == wanted)  # type: ignore[misc]
            assert daemon.done(CheckRegion("only")).verdict == "good"
        assert health(daemon).upsets == 3
        assert daemon.status.mode == "default"
        steps = scrape(daemon.folder / "run").by("cm_change_step_seconds_count", "step")
        assert (steps["load"], steps.get("repair", 0)) == (loads, repairs)
        daemon.board.control.inject("icap_write_only")  # a port that cannot be read is logged; everything else goes on
        before = health(daemon).checks
        daemon.done(ChangeMode("one", "safe"))
        daemon.board.control.clear()
        until(lambda: health(daemon).checks > before)
        assert daemon.status.mode == "safe"


def test_the_safe_mode_is_entered_where_that_is_the_policy(tmp_path: Path) -> None:
    with scrubbed(tmp_path, "safe") as daemon:
        daemon.board.control.upset("only")
        until(lambda: daemon.status.mode == "safe" and not daemon.status.fpga_busy)
        assert daemon.done(CheckRegion("only")).verdict == "good"


def test_what_is_wrong_is_only_told_where_that_is_the_policy_and_counted_once(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with scrubbed(tmp_path, "tell") as daemon:
        daemon.board.control.upset("only", 2)
        until(lambda: health(daemon).wrong_bits == 2)
        before = health(daemon).checks
        until(lambda: health(daemon).checks >= before + 2)
        assert health(daemon).upsets == 2
        assert daemon.done(CheckRegion("only", repair=True)).wrong_bits == 2
        assert health(daemon).wrong_bits == 0
    assert "scrub names a region gone, which no configuration has" in caplog.text
    assert "region only (plain): 2 bits in 2 frames are wrong; policy: tell" in caplog.text
