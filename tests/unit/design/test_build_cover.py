# SPDX-License-Identifier: Apache-2.0
"""The fewest implementation runs, against brute force."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cm.design.plan.minimal_runs import cover

REGIONS = {"a": ["a1", "a2", "a3"], "b": ["b1", "b2"]}


def test_without_modes_the_region_with_most_modules_decides() -> None:
    found = cover(REGIONS, [], True, {"a": "a2", "b": "b2"})
    assert len(found.runs) == found.bound == 3
    assert found.runs[0] == {"a": "a2", "b": "b2"}
    assert {run["a"] for run in found.runs} == {"a1", "a2", "a3"}
    assert {run["b"] for run in found.runs} == {"b1", "b2"}


def test_full_modes_are_the_only_possible_runs() -> None:
    modes = [{"a": f"a{i}", "b": "b1"} for i in (1, 2, 3)] + [{"a": "a3", "b": "b2"}, {"a": "a3", "b": "b3"}]
    found = cover(REGIONS | {"b": ["b1", "b2", "b3"]}, modes, False, modes[1])
    assert (len(found.runs), found.bound, found.exact) == (4, 3, True)  # a3 goes with b2 and b3, a1 and a2 with b1
    assert found.runs[0] == modes[1]


def test_modes_of_different_regions_share_a_run() -> None:
    modes = [{"a": "a1"}, {"a": "a2"}, {"a": "a3"}, {"b": "b1"}, {"b": "b2"}]
    assert len(cover(REGIONS, modes, False, modes[0]).runs) == 3


def test_a_module_in_no_mode_is_left_out_and_reported() -> None:
    found = cover(REGIONS, [{"a": "a1", "b": "b1"}], False, {"a": "a1"})
    assert len(found.runs) == 1
    assert found.left_out == (("a", "a2"), ("a", "a3"), ("b", "b2"))


def reachable(names: list[str], modes: list[dict[str, str]]) -> set[tuple[str | None, ...]]:
    states = {(None,) * len(names)}
    while True:
        more = {tuple(m.get(n, old) for n, old in zip(names, s, strict=True)) for s in states for m in modes} - states
        if not more:
            return states
        states |= more


@st.composite
def systems(draw: st.DrawFn) -> tuple[dict[str, list[str]], list[dict[str, str]]]:
    regions = {f"r{i}": [f"r{i}m{j}" for j in range(draw(st.integers(1, 3)))] for i in range(draw(st.integers(1, 3)))}
    choice = st.fixed_dictionaries({}, optional={name: st.sampled_from(modules) for name, modules in regions.items()})
    return regions, draw(st.lists(choice.filter(bool), min_size=1, max_size=5))


@given(systems())
@settings(max_examples=150, deadline=None)
def test_the_runs_are_reachable_cover_all_and_are_the_fewest(system: tuple[dict, list]) -> None:
    regions, modes = system
    names = list(regions)
    found = cover(regions, modes, False, modes[0])
    states = reachable(names, modes)
    wanted = {(region, module) for mode in modes for region, module in mode.items()}
    assert {pair for run in found.runs for pair in run.items()} == wanted
    assert all(tuple(run.get(name) for name in names) in states for run in found.runs)
    listed = [{(n, m) for n, m in zip(names, state, strict=True) if m} for state in states]
    fewest = next(
        count
        for count in range(1, len(wanted) + 1)
        if any(set().union(*chosen) >= wanted for chosen in itertools.combinations(listed, count))
    )
    assert len(found.runs) == fewest
    assert found.exact


@given(systems())
@settings(max_examples=200, deadline=None)
def test_with_too_many_states_to_list_the_runs_are_reachable_and_cover_all(system: tuple[dict, list]) -> None:
    regions, modes = system
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("cm.design.plan.minimal_runs.MAX_STATES", 0)
        found = cover(regions, modes, free=False, first=modes[0])
    names = list(regions)
    states = reachable(names, modes)
    assert all(tuple(run.get(name) for name in names) in states for run in found.runs)
    used = {(region, module) for mode in modes for region, module in mode.items()}
    assert used <= {pair for run in found.runs for pair in run.items()}
    assert modes[0].items() <= found.runs[0].items()
    assert found.exact is (len(found.runs) <= found.bound)


def test_eight_regions_of_four_modules_need_four_runs() -> None:
    regions = {f"r{n}": [f"m{n}_{index}" for index in range(4)] for n in range(8)}
    modes = [{region: module} for region, modules in regions.items() for module in modules]
    found = cover(regions, modes, free=False, first=modes[0])  # 65536 states
    assert len(found.runs) == 4
    assert found.exact
