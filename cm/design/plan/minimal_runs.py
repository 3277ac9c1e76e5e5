# SPDX-License-Identifier: Apache-2.0
"""The fewest implementation runs that cover all modules and respect the allowed modes.

Every run places one module into each region (or leaves it empty), so at least as many runs are needed
as the region with the most modules has. Without modes in the build schema every combination
is allowed and that bound is reached. With modes, a run must be a state the system can be in:
modes applied one after the other, each leaving the regions it does not name as they are. Choosing
the fewest of them is a minimum set cover (Karp 1972), solved exactly by branch and bound on the
module with the fewest runs that hold it.

Abstract shells: a region with only the surroundings that a module needs, instead of the whole static design.

UG909, "Abstract Shell Design Flow": the first run is unchanged; a shell of each region is made from it, and every
other module is placed and routed in its region's shell. ``pr_verify`` compares the shell with the shell that holds the
module; comparing it with a full design fails ("Verifying Configurations").
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence

from cm.design.platforms import Platform
from cm.design.project.model import Project
from cm.design.project.source_position import fault
from cm.frozen import dataclass

State = tuple[str | None, ...]  # module per region, in the order of the regions
Pair = tuple[int, str]

MAX_STATES = 1_000
MAX_STEPS = 20_000


@dataclass(frozen=True, slots=True)
class Cover:
    """The runs, each as region → module; `bound`: a lower bound of their number; `exact`: proved to be the fewest."""

    runs: tuple[Mapping[str, str], ...]
    bound: int
    exact: bool
    left_out: tuple[tuple[str, str], ...] = ()  # (region, module) that no allowed mode uses

    def __str__(self) -> str:
        proof = "the fewest possible" if self.exact else f"at least {self.bound} are needed"
        return f"{len(self.runs)} implementation run{'s' * (len(self.runs) != 1)} ({proof})"


def cover(
    regions: Mapping[str, Sequence[str]], modes: Iterable[Mapping[str, str]], free: bool, first: Mapping[str, str]
) -> Cover:
    """Find the fewest runs for `regions` (region → its modules).

    `modes`: the allowed combinations (region → module); if `free`, all are allowed. `first`: the mode in which the
    system starts, which the first run must contain.
    """
    bound = max((len(modules) for modules in regions.values()), default=0)
    if free:
        return Cover(_in_turn(regions, first), bound, exact=True)
    names, listed = list(regions), list(modes)
    wanted = {(index, name) for index, region in enumerate(names) for name in regions[region]}
    possible = {(names.index(region), name) for mode in listed for region, name in mode.items()} & wanted
    left_out = sorted((names[index], module) for index, module in wanted - possible)
    bound = max((sum(index == region for index, _ in possible) for region in range(len(names))), default=0)
    chosen, exact = _in_sequence(names, listed, possible, first, bound)
    states, complete = _reachable(names, listed)
    if complete:
        fewest, searched = _fewest(possible, _fullest(states), first, names, chosen)
        if len(fewest) < len(chosen) or searched:
            chosen, exact = fewest, searched
    runs = tuple(_as_mapping(names, state) for state in chosen)
    return Cover(runs, bound, exact=exact, left_out=tuple(left_out))


def _in_turn(regions: Mapping[str, Sequence[str]], first: Mapping[str, str]) -> tuple[Mapping[str, str], ...]:
    """Give every region its modules in turn, beginning with that of `first`; the last one stays."""
    order = {name: sorted(modules, key=lambda module: module != first.get(name)) for name, modules in regions.items()}
    count = max((len(modules) for modules in regions.values()), default=0)
    return tuple(
        {name: modules[min(index, len(modules) - 1)] for name, modules in order.items() if modules}
        for index in range(count)
    )


def _in_sequence(
    names: list[str], modes: list[Mapping[str, str]], possible: set[Pair], first: Mapping[str, str], bound: int
) -> tuple[list[State], bool]:
    """Find states that cover `possible`, each built backwards from its last mode; also whether they are only `bound`.

    An earlier mode determines the regions that later ones do not name, so that every state built this way is one
    that the system can be in, without listing all states. The first run ends with the mode `first`.
    """
    left = set(possible)
    chosen: list[State] = []
    while left or not chosen:
        state: dict[str, str] = {} if chosen else dict(first)
        while len(state) < len(names):
            added = [{r: m for r, m in mode.items() if r not in state and r in names} for mode in modes]
            gains = [(sum((names.index(r), m) in left for r, m in new.items()), len(new)) for new in added]
            best = max(range(len(modes)), key=lambda index: gains[index], default=None)
            if best is None or not gains[best][1]:
                break
            state |= added[best]
        as_state: State = tuple(state.get(name) for name in names)
        if chosen and not _pairs(as_state) & left:
            break
        chosen.append(as_state)
        left -= _pairs(as_state)
    return chosen, len(chosen) <= bound


def _reachable(names: list[str], modes: list[Mapping[str, str]]) -> tuple[dict[State, int], bool]:
    """States after any sequence of modes, in the order in which they are found; False if there are too many to list."""
    empty: State = (None,) * len(names)
    seen = {empty: 0}
    queue = [empty]
    for state in queue:
        for mode in modes:
            after = tuple(mode.get(name, old) for name, old in zip(names, state, strict=True))
            if after not in seen:
                if len(seen) >= MAX_STATES:
                    return seen, False
                seen[after] = len(seen)
                queue.append(after)
    return seen, True


def _fullest(seen: dict[State, int]) -> list[State]:
    """States that no other state contains; for a cover the others are never better."""
    by_size = sorted(seen, key=lambda state: (sum(name is None for name in state), seen[state]))
    kept: list[State] = []
    full = {state for state in by_size if None not in state}
    for state in by_size:
        if state in full or not any(_within(state, other) for other in kept):
            kept.append(state)
    return kept


def _within(small: State, large: State) -> bool:
    return all(mine is None or mine == theirs for mine, theirs in zip(small, large, strict=True))


def _pairs(state: State) -> set[Pair]:
    return {(index, name) for index, name in enumerate(state) if name is not None}


def _as_mapping(names: list[str], state: State) -> dict[str, str]:
    return {name: module for name, module in zip(names, state, strict=True) if module is not None}


def _fewest(
    possible: set[Pair], states: list[State], first: Mapping[str, str], names: list[str], known: list[State]
) -> tuple[list[State], bool]:
    """The fewest states that cover `possible`; the one that fits `first` best comes first."""
    holders = {pair: [state for state in states if state[pair[0]] == pair[1]] for pair in possible}
    found, searched = _search(possible, holders, min(_greedy(possible, states), known, key=len))
    wanted = {(names.index(region), module) for region, module in first.items() if region in names}
    found.sort(key=lambda state: (-len(_pairs(state) & wanted), states.index(state) if state in states else -1))
    return found, searched


def _greedy(possible: set[Pair], states: list[State]) -> list[State]:
    left, chosen = set(possible), []
    while left:
        best = max(states, key=lambda state: len(_pairs(state) & left))
        chosen.append(best)
        left -= _pairs(best)
    return chosen


def _search(possible: set[Pair], holders: dict[Pair, list[State]], start: list[State]) -> tuple[list[State], bool]:
    """The fewest states that cover `possible`, if they are fewer than `start`; also whether all were tried."""
    best, steps = start, 0

    def branch(left: set[Pair], chosen: list[State]) -> None:
        nonlocal best, steps
        steps += 1
        if steps > MAX_STEPS:
            return
        if not left:
            best = chosen
            return
        if len(chosen) + max(Counter(index for index, _ in left).values()) >= len(best):
            return
        hardest = min(left, key=lambda pair: (len(holders[pair]), pair))
        for state in sorted(holders[hardest], key=lambda state: -len(_pairs(state) & left)):
            branch(left - _pairs(state), [*chosen, state])

    branch(possible, [])
    return list(best), steps <= MAX_STEPS


OLDEST = "2020.2"  # the first version of UG835 that has write_abstract_shell


def check_shells(project: Project, platform: Platform) -> None:
    """Raise a fault if Vivado has no abstract shells for this part or in this version."""
    if not project.static.abstract_shells:
        return
    key = ("static", "abstract_shells")
    if not platform.ultrascale:
        message = f"there are no abstract shells for {project.part}: 7 series are not supported (UG909)"
        raise fault(project.source, key, message, "leave it out: every run opens the static design then")
    if project.vivado is not None and project.vivado < OLDEST:
        message = f"Vivado {project.vivado} has no abstract shells"
        raise fault(project.source, key, message, f"{OLDEST} or newer has them")


def first_run(project: Project) -> Cover:
    """The only run of the whole design: the default mode's modules, and one module in every other region."""
    first = project.modes[project.default_mode].modules
    run = {}
    for region in project.regions:
        modules = [module.name for module in project.modules_of(region)]
        if modules:
            run[region] = first.get(region, modules[0])
    return Cover((run,), 1, exact=True)
