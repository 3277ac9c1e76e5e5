# SPDX-License-Identifier: Apache-2.0
"""Regions are compared and put right in the background, as the settings say."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from daemon_thread import Daemon, daemon
from manager_process import until

from cm.errors import Busy
from cm.manager.state.board_state import RegionPhase
from cm.server.scrubbing import Scrubber
from cm.server.settings.model import ScrubSettings
from cm.wire.messages.requests import ChangeMode, CheckRegion, ReadStatus
from cm.wire.messages.status import RegionCheck, RegionHealth

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
    with daemon(schemas=folder, scrub=scrub) as made:
        made.done(ChangeMode("one", "default"))
        yield made


def health(daemon: Daemon) -> RegionHealth:
    (region,) = daemon.status.regions
    return region.health or RegionHealth()


def test_an_upset_is_found_and_repaired_without_being_asked(tmp_path: Path) -> None:
    with scrubbed(tmp_path, "repair") as daemon:
        until(lambda: health(daemon).checks >= 2)
        assert health(daemon).upsets == 0
        for number in range(1, 4):
            daemon.board.control.upset("only")
            until(lambda wanted=number: health(daemon).repairs == wanted)  # type: ignore[misc]
            assert daemon.done(CheckRegion("only")).verdict == "good"
        assert health(daemon).upsets == 3
        assert daemon.status.mode == "default"
        changes = daemon.done(ReadStatus(history=True)).changes
        steps = [step.kind for change in changes for step in change.steps]
        assert (steps.count("load"), steps.count("repair")) == (1, 3)
        daemon.board.control.inject("icap_write_only")  # a port that cannot be read is logged; everything else goes on
        before = health(daemon).checks
        daemon.done(ChangeMode("one", "safe"))
        daemon.board.control.clear()
        until(lambda: health(daemon).checks > before)
        assert daemon.status.mode == "safe"


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
        streams = daemon.status.streams  # of a configuration that names none: the board's channels
        assert {stream.name for stream in streams} == {"camera", "to_pl", "from_pl"}
    assert "scrub names a region gone, which no configuration has" in caplog.text
    assert "region only (plain): 2 bits in 2 frames are wrong; policy: tell" in caplog.text


class Bench:
    """A scrubber over a manager whose passes end when a test says so; the loop's timers are called by it too."""

    def __init__(self, policy: str) -> None:
        self.timers: list[tuple[float, Any]] = []
        self.checks: list[Any] = []  # what ends each pass, and its pace
        self.acts: list[tuple[Any, Any]] = []
        self.held = SimpleNamespace(phase=RegionPhase.READY, module="plain")
        self.refuses: dict[str, Exception] = {}
        manager: Any = SimpleNamespace(
            configs={"one": SimpleNamespace(regions={"only": None})}, state=SimpleNamespace(region=lambda _: self.held),
            prepared_check=lambda name: self._may("prepare") or name, check=self._check,
            repair=self._act,
        )  # fmt: skip
        loop: Any = SimpleNamespace(
            call_later=lambda seconds, call: self.timers.append((seconds, call)), call_threadsafe=lambda call: call()
        )
        thread: Any = SimpleNamespace(submit=lambda work: work())
        Scrubber(loop, manager, thread, {"only": ScrubSettings(every=5.0, budget=0.02, policy=policy)}).begin()

    def _act(self, request: Any, done: Any, why: str) -> None:
        self._may("act")
        assert why == "as bits of region only were wrong (scrub)"
        self.acts.append((request, done))

    def _may(self, what: str) -> None:
        if what in self.refuses:
            raise self.refuses[what]

    def _check(self, what: str, done: Any, pace: Any) -> None:
        assert what == "only"
        self._may("check")
        self.checks.append((done, pace))

    def pass_time(self) -> int:
        """Call the timer that was set; returns how many passes began."""
        ((seconds, call),) = self.timers
        assert seconds == 5.0
        self.timers.clear()
        before = len(self.checks)
        call()
        return len(self.checks) - before

    def ends(self, verdict: str) -> None:
        self.checks[-1][0](RegionCheck("only", "plain", verdict, wrong_bits=3, wrong_frames=2))


@pytest.mark.parametrize(
    ("policy", "request_"),
    [
        ("repair", CheckRegion("only", repair=True)),
        ("tell", None),
    ],
)
def test_the_next_pass_follows_what_the_one_before_led_to(
    policy: str, request_: Any, caplog: pytest.LogCaptureFixture
) -> None:
    it = Bench(policy)
    assert [it.pass_time() for _ in range(3)] == [1, 0, 0]  # it has not ended
    it.ends("good")
    assert it.pass_time() == 1
    it.ends("wrong")
    (record,) = caplog.records
    assert record.getMessage() == f"region only (plain): 3 bits in 2 frames are wrong; policy: {policy}"
    assert [request for request, _ in it.acts] == ([] if request_ is None else [request_])
    for _, done in it.acts:
        assert it.pass_time() == 0
        done(None)
    assert it.pass_time() == 1


@pytest.mark.parametrize("at", ["prepare", "check", "act"])
def test_what_refuses_a_pass_is_logged_once_until_one_succeeds(at: str, caplog: pytest.LogCaptureFixture) -> None:
    it = Bench("repair")
    for said in ("a change runs", "a change runs", "another", None, "another"):
        it.refuses = {at: Busy(said)} if said else {}
        it.pass_time()
        if it.checks and at == "act":
            it.ends("wrong" if said else "good")
        elif said is None:
            it.ends("good")
    told = [r.getMessage() for r in caplog.records if "not compared" in r.getMessage()]
    once = ["a change runs", "another", "another"] if at != "act" else ["a change runs"] * 2 + ["another"] * 2
    assert told == [f"region only is not compared: {said}" for said in once]


def test_a_pass_takes_its_share_of_the_time_and_a_region_that_is_not_ready_none() -> None:
    it = Bench("tell")
    it.pass_time()
    it.timers.clear()
    it.checks[-1][1](0.1, "go on")
    assert it.timers == [(pytest.approx(4.9), "go on")]  # of a fiftieth
    for phase, module in ((RegionPhase.UNKNOWN, "plain"), (RegionPhase.READY, None)):
        it = Bench("tell")
        it.held = SimpleNamespace(phase=phase, module=module)
        assert [it.pass_time() for _ in range(2)] == [0, 0]
