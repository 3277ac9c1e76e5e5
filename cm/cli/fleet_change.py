# SPDX-License-Identifier: Apache-2.0
"""``cm fleet mode|load|reconcile``: a change of many boards as one, and the way back to what is wanted of them."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING, Any

from cm.cli.common import print_json, print_table, seconds, slashed
from cm.cli.fleet_options import add_fleet_options, answer_boards, connected_fleet

if TYPE_CHECKING:
    from cm.networks.fleet.coordinator import Course, Leg

_PHASES = {"open": "opened", "prepare": "prepared", "apply": "changed", "decide": "decided", "reconcile": "settled"}


def add(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the actions."""
    mode = actions.add_parser("mode", help="change the mode of all boards, or of none")
    mode.add_argument("target", type=slashed, metavar="[CONFIG/]MODE")
    load = actions.add_parser("load", help="load a configuration on all boards, or on none")
    load.add_argument("target", type=slashed, metavar="CONFIG[/MODE]", help="by default in its default mode")
    for parser in (mode, load):
        add_fleet_options(parser, run)
        parser.add_argument(
            "--policy",
            type=_policy,
            choices=("all", "quorum", "best-effort"),
            default="all",
            help="how many boards must succeed for the change to be kept (all)",
        )
        parser.add_argument(
            "--absent",
            choices=("refuse", "go-on"),
            default="",
            help="what to do about boards that are away: change nothing (default under --policy all), or go on: they "
            "follow when they are back",
        )
        parser.add_argument(
            "--phase", type=seconds, default=60.0, metavar="SECONDS", help="time-out of each phase (60)"
        )
    again = actions.add_parser(
        "reconcile",
        help="have boards go where they are wanted, now",
        description="Have boards go where they are wanted, now: take back what somebody changed by hand, and try again "
        "what has failed. Exit status 1 if a board is not where it is wanted then.",
    )
    add_fleet_options(again, run_reconcile)


def _policy(said: str) -> str:
    return said.replace("_", "-")


def run(args: argparse.Namespace) -> int:
    """Change; 0 where every named board is in the new mode."""
    from cm.networks.fleet.errors import ChangeFailed

    if args.action == "mode":
        config, _, mode = args.target.rpartition("/")
    else:
        config, _, mode = args.target.partition("/")
    with connected_fleet(args) as fleet:
        try:
            course = fleet.load(
                config,
                mode,
                args.boards,
                policy=args.policy,
                absent=args.absent,
                timeout=args.phase,
                tell=_nothing if args.json else _tell,
            )
        except ChangeFailed as error:
            _show(args, error.course)
            print(f"cm: {error}", file=sys.stderr)
            return 1
    _show(args, course)
    return 0


def run_reconcile(args: argparse.Namespace) -> int:
    """Go where it is wanted; 0 where every board is there."""
    from cm.networks.fleet.status_text import FINE, wanted

    with connected_fleet(args) as fleet:
        found = fleet.reconcile(args.boards)

    def row(name: str, each: Any) -> tuple[object, ...]:
        return name, each.state, wanted(each), each.error.message if each.error else each.store_error

    headers = ("BOARD", "STATE", "WANTED", "")
    return answer_boards(args, found, headers, row, lambda each: each.state in FINE, unknown="?")


def _nothing(*_: object) -> None:
    pass


def _tell(phase: str, board: str, answer: Any) -> None:
    """A line on a terminal's standard error for each answer."""
    if sys.stderr.isatty():
        state = getattr(answer, "state", "") or getattr(answer, "message", "")
        print(f"\r\033[K{_PHASES.get(phase, phase)}: {board} ({state})", end="", file=sys.stderr, flush=True)


def _show(args: argparse.Namespace, course: Course) -> None:
    if args.json:
        print_json(as_json(course))
        return
    if sys.stderr.isatty():
        print("\r\033[K", end="", file=sys.stderr)
    rows: list[tuple[object, ...]] = []
    for name, state in sorted(course.states.items()):
        figures = course.figures.get(name, state)
        took = f"{figures.seconds * 1000:.1f}" if figures.seconds else course.differing.get(name, "")
        to = f"{figures.config_name}/{figures.mode}"
        rows.append((name, state.state, to, f"{figures.plan_seconds * 1000:.1f}", took))
    rows += [(name, "?", "", "", error.message) for name, error in sorted(course.silent.items())]
    if rows:
        print_table(rows, ("BOARD", "STATE", "TO", "PLANNED MS", "TOOK MS"))
    print(critical_path(course))


def critical_path(course: Course) -> str:
    """What the change waited for, phase by phase."""
    return f"generation {course.generation}; {course.seconds * 1000:.1f} ms: " + ", ".join(map(_leg, course.legs))


def _leg(leg: Leg) -> str:
    last = f" (last {leg.slowest})" if leg.slowest else ""
    return f"{_PHASES.get(leg.phase, leg.phase)} {leg.seconds * 1000:.1f} ms{last}"


def as_json(course: Course) -> dict[str, Any]:
    """For scripts."""
    from cm.wire.messages.json_values import plain

    return {
        "change": course.id,
        "generation": course.generation,
        "decision": course.decision.value if course.decision else None,
        "boards": {name: plain(state) for name, state in course.states.items()},
        "differing": course.differing,
        "causes": {name: plain(error) for name, error in course.causes.items()},
        "seconds": course.seconds,
        "critical_path": [plain(leg) for leg in course.legs],
    }
