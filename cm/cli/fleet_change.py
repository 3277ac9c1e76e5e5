# SPDX-License-Identifier: Apache-2.0
"""``cm fleet mode|load``: a change of many boards as one."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING, Any

from cm.cli.common import add_json_option, print_json, print_table, seconds
from cm.cli.fleet_options import add_fleet_options, connected_fleet

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cm.networks.fleet.change.coordinator import Outcome
    from cm.networks.fleet.changing import Course, Leg
    from cm.wire.messages.fleet import BoardStatus
    from cm.wire.messages.status import ErrorInfo

_PHASES = {"prepare": "prepared", "apply": "changed", "seat": "decided", "tell": "told"}


def add(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the actions."""
    mode = actions.add_parser("mode", help="change the mode of all boards, or of none")
    mode.add_argument("mode", metavar="MODE")
    mode.set_defaults(config="")
    load = actions.add_parser("load", help="load a configuration on all boards, or on none")
    load.add_argument("config", metavar="CONFIG")
    load.add_argument("mode", metavar="MODE", help="mode of the configuration; '' for its default mode")
    for parser in (mode, load):
        add_fleet_options(parser)
        add_json_option(parser)
        parser.add_argument(
            "--policy",
            type=_policy,
            choices=("all", "quorum", "best-effort"),
            default="all",
            help="how many boards must succeed for the change to be kept (all)",
        )
        parser.add_argument(
            "--phase", type=seconds, default=60.0, metavar="SECONDS", help="time-out of each phase (60)"
        )
        parser.add_argument(
            "--settle",
            type=seconds,
            default=0.0,
            metavar="SECONDS",
            help="how long a board waits for the decision before it asks for it (twice --phase)",
        )
        parser.set_defaults(run=run)
    _add_ends(actions)


def _add_ends(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    recover = actions.add_parser(
        "recover",
        help="end changes whose client has gone, or name the boards that still wait",
        description="Boards end such changes by themselves once their time is over. This command does it at once, and "
        "says how each change ended. Exit status 1 if a board is not where the decision wants it, or still waits.",
    )
    recover.add_argument(
        "--change", default="", metavar="CHANGE", help="only this change, even if its time is not over yet"
    )
    add_fleet_options(recover)
    add_json_option(recover)
    recover.set_defaults(run=run_recover)
    settle = actions.add_parser(
        "settle",
        help="decide for boards that wait for deciding boards that will not come back",
        description="For use when most of a change's deciding boards (its seats) are gone for good. It is refused if "
        "the boards can still find out what was decided and that is something else.",
    )
    settle.add_argument("change", metavar="CHANGE", help="the change, as `cm fleet status` names it")
    settle.add_argument("decision", choices=("keep", "revert"), help="stay in the new mode, or go back")
    add_fleet_options(settle)
    settle.set_defaults(run=run_settle)


def _policy(said: str) -> str:
    return said.replace("_", "-")


def run(args: argparse.Namespace) -> int:
    """Change; 0 where every board is in the new mode."""
    from cm.networks.fleet.errors import ChangeFailed

    with connected_fleet(args) as fleet:
        try:
            course = fleet.load(
                args.config,
                args.mode,
                args.boards,
                policy=args.policy,
                timeout=args.phase,
                settle=args.settle,
                tell=_nothing if args.json else _tell,
            )
        except ChangeFailed as error:
            _show(args, error.outcome)
            print(f"cm: {error}", file=sys.stderr)
            return 1
    _show(args, course.outcome, course)
    return 0


def run_recover(args: argparse.Namespace) -> int:
    """End what is open; 0 where every board is where its change was decided to lead."""
    from cm.networks.fleet.errors import sentence

    with connected_fleet(args) as fleet:
        found = fleet.recover(args.change, args.boards)
        early = {} if found or args.json else fleet.status(args.boards)
    failed = any(outcome.decision is None or outcome.differing for outcome in found.values())
    if args.json:
        print_json({change: as_json(outcome, None) for change, outcome in found.items()})
        return int(failed)
    for change, outcome in found.items():
        print(f"{change}: {sentence(outcome)}")
    if not found:
        print("no change of the fleet is open whose time is over" + _still_open(early))
    return int(failed)


def _still_open(statuses: Mapping[str, BoardStatus | ErrorInfo]) -> str:
    """Changes that are still open."""
    from cm.networks.fleet.change import member
    from cm.wire.messages.status import ErrorInfo

    records = [status.fleet for status in statuses.values() if not isinstance(status, ErrorInfo)]
    named = sorted({record.id for record in records if record is not None and not member.ended(record)})
    return f"; {', '.join(named)} may still be at work: `--change {named[0]}` ends it now" if named else ""


def run_settle(args: argparse.Namespace) -> int:
    """Decide in the seats' place; 0 where every board has done it."""
    from cm.wire.messages.status import ErrorInfo

    with connected_fleet(args) as fleet:
        found = fleet.settle(args.change, args.decision == "keep", args.boards)
    rows = [(n, "", r.message) if isinstance(r, ErrorInfo) else (n, r.state, "") for n, r in found.items()]
    print_table(rows, ("BOARD", "STATE", ""))
    return int(any(isinstance(record, ErrorInfo) for record in found.values()))


def _nothing(*_: object) -> None:
    pass


def _tell(phase: str, board: str, answer: Any) -> None:
    """A line on a terminal's standard error for each answer."""
    if sys.stderr.isatty():
        state = getattr(answer, "state", "") or getattr(answer, "message", "")
        print(f"\r\033[K{_PHASES.get(phase, phase)}: {board} ({state})", end="", file=sys.stderr, flush=True)


def _show(args: argparse.Namespace, outcome: Outcome, course: Course | None = None) -> None:
    if args.json:
        print_json(as_json(outcome, course))
        return
    if sys.stderr.isatty():
        print("\r\033[K", end="", file=sys.stderr)
    rows = [
        (name, record.state, f"{record.config_name}/{record.mode}", f"{record.plan_seconds * 1000:.1f}", _took(record))
        for name, record in sorted(outcome.records.items())
    ]
    rows += [(name, "?", "", "", error.message) for name, error in sorted(outcome.silent.items())]
    if rows:
        print_table(rows, ("BOARD", "STATE", "TO", "PLANNED MS", "TOOK MS"))
    if course is not None:
        print(critical_path(course))


def _took(record: Any) -> str:
    return f"{record.seconds * 1000:.1f}" if record.seconds else record.error.message if record.error else ""


def critical_path(course: Course) -> str:
    """What the change waited for, phase by phase."""
    return f"{course.seconds * 1000:.1f} ms in all: " + ", ".join(map(_leg, course.legs))


def _leg(leg: Leg) -> str:
    return f"{_PHASES.get(leg.phase, leg.phase)} {leg.seconds * 1000:.1f} ms (last {leg.slowest})"


def as_json(outcome: Outcome, course: Course | None) -> dict[str, Any]:
    """For scripts."""
    from cm.cli.client import plain

    found: dict[str, Any] = {
        "change": outcome.id,
        "decision": outcome.decision.value if outcome.decision else None,
        "boards": {name: plain(record) for name, record in outcome.records.items()},
        "differing": dict(outcome.differing),
        "causes": {name: plain(error) for name, error in outcome.causes.items()},
    }
    if course is not None:
        found["seconds"] = course.seconds
        found["critical_path"] = [plain(leg) for leg in course.legs]
    return found
