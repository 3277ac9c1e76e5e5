# SPDX-License-Identifier: Apache-2.0
"""Rounds, ratios, goals, and missing baselines."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from cm.cli.main import main
from cm.tools.bench import catalogue, report
from cm.tools.bench.c_programs import build
from cm.tools.bench.catalogue import NAMES, Case, chosen
from cm.tools.bench.peer import Peer, Unavailable
from cm.tools.bench.result import Goal, Result, unavailable
from cm.tools.bench.rounds import Plan, Samples, interleave


def test_contestants_take_turns_and_their_warm_trips_do_not_count() -> None:
    order: list[str] = []

    def contestant(name: str, duration: float):  # type: ignore[no-untyped-def]
        def batch(count: int) -> tuple[float, ...]:
            order.append(f"{name}{count}")
            return (duration,) * count

        return batch

    found = interleave({"a": contestant("a", 1.0), "b": contestant("b", 2.0)}, Plan(2, 3, 1))
    assert order == ["a1", "a3", "b1", "b3"] * 2
    assert found["a"].all == (1.0,) * 6


def test_a_ratio_is_of_rounds_so_that_a_slow_round_slows_both() -> None:
    ours, theirs = Samples(((10.0,), (100.0,), (10.0,))), Samples(((5.0,), (50.0,), (5.0,)))
    assert ours.over(theirs) == 2.0


def test_the_99th_percentile_is_a_sample() -> None:
    assert Samples((tuple(float(i) for i in range(1, 101)),)).p99 == 100.0
    assert Samples(((7.0,),)).p99 == 7.0


def test_a_goal_looks_at_the_ratio_where_there_is_a_baseline() -> None:
    assert Result("x", 50.0, "µs", "", baseline=10.0, ratio=5.0, goal=Goal(4, at_least=True)).met
    assert not Result("x", 50.0, "µs", "", baseline=10.0, ratio=5.0, goal=Goal(1.5)).met
    assert Result("x", 0.4, "s", "", goal=Goal(0.5)).met
    assert Result("x", 0.4, "s", "").met is None


def test_unavailable_results_are_recorded_in_the_file(tmp_path: Path) -> None:
    report.write(tmp_path / "x.json", [unavailable("x", "µs", "what would run", "no such thing", Goal(2))], {})
    found = json.loads((tmp_path / "x.json").read_text(encoding="utf-8"))["x"]
    assert found["missing"] == "no such thing"
    assert found["value"] is found["ratio"] is found["met"] is None


def test_a_missing_package_is_named_with_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "iceoryx2", None)
    monkeypatch.delitem(sys.modules, "cm.tools.bench.peers.iceoryx2_events", raising=False)
    with pytest.raises(Unavailable, match=r"pip install 'fpga-cm\[bench\]'"):
        Peer("iceoryx2", tmp_path, 64)


def test_without_a_compiler_the_c_program_is_not_available(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "no-such-compiler")
    with pytest.raises(Unavailable, match="no C compiler"):
        build(tmp_path, "copies")


def test_a_baseline_echoes_what_it_is_sent(tmp_path: Path) -> None:
    with Peer("zmq", tmp_path, 5000) as far:
        assert far.trip() == b"\x5a" * 5000


def test_an_unknown_name_is_refused_with_the_known_ones(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "frames"]) == 1
    assert NAMES[0] in capsys.readouterr().err


def test_results_of_one_module_are_measured_once() -> None:
    assert [case.module for case in chosen(["frame_pl_vs_c", "frame_pl_vs_zmq"])] == ["frame_pl"]


def test_what_is_missing_is_said_first_and_what_fails_costs_nothing_that_was_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    began: list[str] = []

    def made(name: str) -> Any:
        def run(_: Any) -> list[Result]:
            began.append(name)
            if name == "flood":
                raise ValueError("no such socket")
            return [Result(name, 1.5, "ms", "what ran")]

        return SimpleNamespace(run=run, __doc__=f"What {name} measures.")

    cases = (
        Case("fanout", ("fanout",), beside=("no_such_peer",)), Case("flood", ("flood",)),
        Case("advisor", ("advisor",), needs="no_such_package"), Case("footprint", ("footprint",)),
    )  # fmt: skip
    monkeypatch.setattr(catalogue, "CASES", cases)
    monkeypatch.setattr(catalogue, "import_module", lambda name: made(name.rpartition(".")[2]))
    assert main(["bench", "--quick", "--json", str(tmp_path / "x.json")]) == 1
    told = capsys.readouterr()
    found = json.loads((tmp_path / "x.json").read_text(encoding="utf-8"))
    assert {name: found[name]["value"] for name in ("fanout", "flood", "advisor", "footprint")} == {
        "fanout": 1.5, "flood": None, "advisor": None, "footprint": 1.5,
    }  # fmt: skip
    assert found["flood"]["missing"] == "failed: no such socket"
    assert found["advisor"]["missing"] == "not available without no_such_package: pip install 'fpga-cm[bench]'"
    assert found["advisor"]["ran"] == "What advisor measures."
    assert began == ["fanout", "flood", "footprint"]
    assert told.err.splitlines()[:2] == [
        "cm bench: fanout is measured without no_such_peer, which is not installed",
        "cm bench: advisor: not available without no_such_package: pip install 'fpga-cm[bench]'",
    ]
    assert "footprint    1.5 ms" in told.out
