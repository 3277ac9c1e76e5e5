# SPDX-License-Identifier: Apache-2.0
"""``cm fleet status|watch|plan|reg``: what many boards say."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from cm.cli.common import number, print_json, print_table, slashed
from cm.cli.fleet_options import ALL, add_fleet_options, answer_boards, connected_fleet
from cm.wire.messages.json_values import plain

if TYPE_CHECKING:
    from cm.wire.messages.fleet import BoardStatus
    from cm.wire.messages.status import ErrorInfo


def add(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the actions."""
    for name, run, text in (
        ("status", run_status, "show what is loaded where, what is wanted there, and how closely the clocks agree"),
        ("watch", run_watch, "follow the boards as they change, come and go"),
    ):
        parser = actions.add_parser(name, help=text)
        add_fleet_options(parser, run)
    _add_plan(actions)
    _add_reg(actions)


def _add_plan(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = actions.add_parser("plan", help="show what a change of mode would do on each board")
    parser.add_argument("target", type=slashed, metavar="[CONFIG/]MODE")
    add_fleet_options(parser, run_plan)


def _add_reg(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = actions.add_parser("reg", help="read and write a register of each board")
    verbs = parser.add_subparsers(dest="verb", metavar="ACTION", required=True)
    for verb in ("read", "write"):
        each = verbs.add_parser(verb, help=f"{verb} a register, or a field, of each board")
        each.add_argument("name", metavar="NAME" if verb == "read" else "NAME=VALUE")
        add_fleet_options(each, run_reg)
        each.set_defaults(refuse=each.error)


def run_status(args: argparse.Namespace) -> int:
    """Print a line for each board; 1 where one of them did not answer, or is not where it is wanted."""
    from cm.networks.fleet.status_text import stands_apart
    from cm.wire.messages.status import ErrorInfo

    with connected_fleet(args) as fleet:
        found = fleet.status(args.boards)
    failed = any(isinstance(status, ErrorInfo) or stands_apart(status) for status in found.values())
    if args.json:
        print_json({name: _plain(status) for name, status in found.items()})
    elif not found:
        print(NOBODY)
    else:
        print_table([_row(name, status) for name, status in found.items()], HEADERS)
    return int(failed)


NOBODY = "no board's bridge is running"
HEADERS = ("BOARD", "CONFIG", "MODE", "STATE", "FLEET", "LABELS", "NOTE")


def _row(name: str, status: BoardStatus | ErrorInfo) -> tuple[object, ...]:
    from cm.networks.fleet.status_text import note
    from cm.wire.messages.status import ErrorInfo

    if isinstance(status, ErrorInfo):
        return name, "", "", "no answer" if status.code == "no_answer" else status.code, "away", "", status.message
    own = status.status
    why = note(name, status) or (own.last_error.message if own.last_error else "")
    state, fleet = "busy" if own.fpga_busy else own.pr_mode.value, status.fleet.state if status.fleet else ""
    return name, own.config_name, own.mode, state, fleet, " ".join(status.labels), why


def run_watch(args: argparse.Namespace) -> int:
    """Print each change until interrupted; the exit status."""
    with connected_fleet(args) as fleet:
        chosen = None if args.boards == ALL else frozenset(fleet.chosen(args.boards))
        told: dict[str, tuple[object, ...]] = {}
        with fleet.watch() as statuses:
            for name, status in statuses:
                if chosen is None or name in chosen:
                    _tell(args, told, name, status)
    return 0


def _tell(args: argparse.Namespace, told: dict[str, tuple[object, ...]], name: str, status: BoardStatus | None) -> None:
    """A status that says the same as the one before is not printed again."""
    if status is None:
        told.pop(name, None)
        line: tuple[object, ...] = (name, "gone")
    else:
        line = _row(name, status)
        if told.get(name) == line[:6]:
            return
        told[name] = line[:6]
    if args.json:
        print_json({"board": name, "status": None if status is None else plain(status)}, lines=True)
    else:
        print("  ".join(str(cell) for cell in line if cell), flush=True)


def run_plan(args: argparse.Namespace) -> int:
    """Print what each board would do; 1 where one of them cannot."""
    config, _, mode = args.target.rpartition("/")
    with connected_fleet(args) as fleet:
        found = fleet.plan(mode, config, args.boards)

    def row(name: str, plan: Any) -> tuple[object, ...]:
        return name, len(plan.steps), plan.bytes, f"{plan.seconds * 1000:.1f}", f"{plan.config_name}/{plan.mode}"

    return answer_boards(args, found, ("BOARD", "STEPS", "BYTES", "MS", "TO"), row, as_json=_plain)


def run_reg(args: argparse.Namespace) -> int:
    """Read or write; 1 where a board could not."""
    register, same, value = args.name.partition("=")
    if args.verb == "write" and not same:
        args.refuse(f"{register!r} is not NAME=VALUE")
    with connected_fleet(args) as fleet:
        if args.verb == "read":
            found = fleet.read(args.name, args.boards)
        else:
            found = fleet.write({register: _value(value)}, args.boards)

    def row(name: str, values: Any) -> tuple[object, ...]:
        return name, _shown(register, values), ""

    return answer_boards(args, found, ("BOARD", register, ""), row, as_json=_plain)


def _shown(name: str, values: Any) -> str:
    found = values.values[0]
    field = name.partition(".")[2]
    return f"{dict(found.fields).get(field, found.value):#x}"


def _value(text: str) -> int | str:
    try:
        return number(text)
    except ValueError:
        return text


def _plain(value: Any) -> Any:
    from cm.wire.messages.status import ErrorInfo

    if isinstance(value, ErrorInfo):
        return {"error": {"code": value.code, "message": value.message}}
    return value._asdict() if hasattr(value, "_asdict") else plain(value)
