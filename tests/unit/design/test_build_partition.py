# SPDX-License-Identifier: Apache-2.0
"""The partitioning advisor against every possible partition."""

from __future__ import annotations

import random
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from build_support import EXAMPLES, NAMES, STREAM_MODULE, project
from hypothesis import given, settings
from hypothesis import strategies as st

from cm.design.errors import BuildError, MissingTool
from cm.design.partition.advisor import advise
from cm.design.partition.model import Part, Problem, Unit, UsedMode, compatible, evaluate, group_of
from cm.design.partition.utilisation import part_of
from cm.design.project.model import Resources

pytest.importorskip("scipy", reason="needs scipy: the extra [build] is not installed")

PART = Part("toy", Resources(1000, 2000, 100, 100), 1_000_000)


def partitions(names: list[str]) -> Iterator[list[list[str]]]:
    if not names:
        yield []
        return
    first, *rest = names
    for parts in partitions(rest):
        yield [[first], *parts]
        for index in range(len(parts)):
            yield [*parts[:index], [first, *parts[index]], *parts[index + 1 :]]


def apart(problem: Problem, parts: list[list[str]]) -> bool:
    return any(0 < len(names.intersection(part)) < len(names) for names in problem.together for part in parts)


def brute_force(problem: Problem, objective: str) -> float | None:
    figures = [
        evaluate(problem, [group_of(problem, names) for names in parts])
        for parts in partitions(list(problem.units))
        if all(compatible(problem, names) for names in parts) and not apart(problem, parts)
    ]
    return min((getattr(found, objective) for found in figures if found.fits), default=None)


@st.composite
def problems(draw: st.DrawFn) -> Problem:
    count = draw(st.integers(1, 5))
    sizes = st.builds(Resources, st.integers(1, 500), st.integers(0, 900), st.integers(0, 40), st.integers(0, 40))
    kinds = st.sampled_from(["", "stream"])
    units = {f"m{i}": Unit(f"m{i}", draw(sizes), draw(kinds)) for i in range(count)}
    chosen = st.frozensets(st.sampled_from(sorted(units)), min_size=1)
    modes = draw(st.lists(chosen, min_size=1, max_size=4))
    listed = [UsedMode(f"mode{i}", names, draw(st.sampled_from([0.5, 1.0, 3.0]))) for i, names in enumerate(modes)]
    static = Resources(draw(st.sampled_from([0, 200])))
    room = draw(st.sampled_from([1.0, 0.5]))
    together = [draw(st.frozensets(st.sampled_from(sorted(units)), min_size=2, max_size=2))] if count > 2 else []
    bound = together if draw(st.booleans()) else []
    return Problem(PART, units, listed, 1e6, static, room, draw(st.sampled_from([None, 1, 2])), bound)


@given(problems(), st.sampled_from(["worst", "mean"]))
@settings(max_examples=120, deadline=None)
def test_no_partition_beats_the_proposal(problem: Problem, objective: str) -> None:
    best = brute_force(problem, objective)
    if best is None:
        with pytest.raises(BuildError, match="no partition fits"):
            advise(problem, objective)
        return
    found = advise(problem, objective)
    assert found.fits
    assert getattr(found, objective) == pytest.approx(best, rel=1e-6, abs=1e-9)
    assert found.gap(objective) == 0
    assert not apart(problem, [list(group.modules) for group in found.groups])
    assert sorted(name for group in found.groups for name in group.modules) == sorted(problem.units)


def test_without_the_solver_the_extra_that_brings_it_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "scipy.optimize", None)
    with pytest.raises(MissingTool, match=r"needs scipy: pip install .*'scipy>="):
        advise(Problem(PART, {"a": Unit("a", Resources(10))}, [UsedMode("a", frozenset("a"))], 1e6))


def test_what_the_static_part_needs_and_a_budget_leave_less_room() -> None:
    units = {name: Unit(name, Resources(300)) for name in "ab"}
    modes = [UsedMode(name, frozenset(name)) for name in "ab"]
    assert len(advise(Problem(PART, units, modes, 1e6)).groups) == 2
    assert len(advise(Problem(PART, units, modes, 1e6, Resources(400))).groups) == 1
    assert len(advise(Problem(PART, units, modes, 1e6, budget=0.4)).groups) == 1
    with pytest.raises(BuildError, match=r"more than the 20\.0% that is left for regions"):
        advise(Problem(PART, units, modes, 1e6, Resources(500), 0.2))


def thirty_modules(seed: int) -> tuple[dict[str, Unit], list[UsedMode]]:
    """Thirty modules of four kinds; each of twenty modes has one module of each kind."""
    draw = random.Random(seed)
    units = {f"m{i}": Unit(f"m{i}", Resources(draw.randint(300, 4000), 0, 0, draw.randint(0, 20))) for i in range(30)}
    slots = [[f"m{i}" for i in range(30) if i % 4 == slot] for slot in range(4)]
    return units, [UsedMode(f"mode{i}", frozenset(draw.choice(names) for names in slots)) for i in range(20)]


@pytest.mark.parametrize("objective", ["worst", "mean"])
def test_thirty_modules_twenty_modes_and_four_slots_are_solved(objective: str) -> None:
    units, modes = thirty_modules(7)
    problem = Problem(part_of("xc7z020"), units, modes, 4e8, budget=0.5, regions=4)
    found = advise(problem, objective, 300)
    assert found.fits
    assert len(found.groups) == 4
    assert found.gap(objective) == 0  # proved, and HiGHS takes a tenth of a second for it
    slots = [[name for name in units if int(name[1:]) % 4 == slot] for slot in range(4)]
    obvious = evaluate(problem, [group_of(problem, names) for names in slots])
    assert obvious.fits
    assert getattr(found, objective) <= getattr(obvious, objective)


def test_when_time_runs_out_the_gap_to_the_optimum_is_reported() -> None:
    units, modes = thirty_modules(7)
    problem = Problem(part_of("xc7z020"), units, modes, 4e8)
    found = advise(problem, "worst", 0.001)
    assert found.fits
    assert 0 < found.gap("worst") <= 1


def test_the_worst_change_takes_the_regions_bytes_at_the_ports_rate() -> None:
    units = {name: Unit(name, Resources(400)) for name in "ab"}
    problem = Problem(PART, units, [UsedMode(name, frozenset(name)) for name in "ab"], 1e6)
    found = evaluate(problem, [group_of(problem, ["a", "b"])])
    # 1.2 * 400 of 1000 is 48 %, rounded up to 31/64 of the device
    assert found.groups[0].bytes == 1_000_000 * 31 // 64
    assert found.worst == pytest.approx(found.groups[0].bytes / 1e6)


def test_the_command_shows_todays_assignment_beside_the_proposal(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    pytest.importorskip("pyslang", reason="needs pyslang: the extra [build] is not installed")
    from cm.cli.main import main

    text = """\
        project: {name: small, part: xc7z020clg400-1}
        regions: {prr0: {}}
        modules:
          one: {sources: [one.v], resources: {lut: 9000}}
          two: {sources: [two.v], resources: {lut: 900}}
          three: {sources: [three.v], resources: {lut: 800}}
        """
    more = {name: STREAM_MODULE.format(name=name, high=31) for name in ("two", "three")}
    path = project(tmp_path, text, **more)
    assert main(["build", "partition", str(path), "--objective", "mean"]) == 0
    said = capsys.readouterr().out
    assert "today: worst" in said
    assert "proposed: worst" in said
    assert "one, two, three" in said.partition("proposed")[0]
    assert "proposed: worst 0.000 ms" in said  # all three fit side by side
    assert main(["build", "partition", str(path), "--budget", "23"]) == 0
    assert "0  one, two, three" in capsys.readouterr().out.partition("proposed")[2]


def test_the_shipped_examples_can_be_advised(capsys: pytest.CaptureFixture) -> None:
    pytest.importorskip("pyslang", reason="needs pyslang: the extra [build] is not installed")
    from cm.cli.main import main

    for name in NAMES:
        assert main(["build", "partition", str(EXAMPLES / name / "build.yaml"), "--budget", "4"]) == 0
        assert "proposed: worst" in capsys.readouterr().out
