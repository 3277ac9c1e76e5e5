# SPDX-License-Identifier: Apache-2.0
"""``cm config list|show|send|remove|check|versions|rollback``: configurations of a manager, in files, earlier ones."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from cm.cli.common import add_board_options, add_json_option, answer, answer_table, completes, naming, print_json
from cm.cli.connection import connected
from cm.client.errors import RequestFailed
from cm.wire.messages.json_values import plain

if TYPE_CHECKING:
    from collections.abc import Iterator

    from cm.client.board import Board
    from cm.wire.messages.status import ConfigEntry, ConfigInfo

_FIRMWARE = Path("/lib/firmware/cm")  # as `cm import archive` has it


def fill_parser(parser: argparse.ArgumentParser) -> None:
    """Describe the command."""
    parser.description = (
        "Configurations that the manager has (list, send, remove), runtime schemas in files (check), and "
        "earlier versions of what `cm import archive` installed (rollback)."
    )
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    _add_to_manager(actions)
    _add_check(actions)
    _add_rollback(actions)


def _add_to_manager(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    listing = actions.add_parser("list", help="list the configurations and their modes")
    add_board_options(listing, run_list)
    show = actions.add_parser("show", help="show a configuration: its modes, registers, streams, interrupts, memories")
    completes(show.add_argument("config", metavar="CONFIG", nargs="?", default=""), "<config>")
    show.add_argument("--yaml", action="store_true", help="its runtime schema, as the manager has it")
    add_board_options(show, run_show)
    send = actions.add_parser(
        "send", help="send a schema file, and the bitstreams and overlays that belong to it, to the manager"
    )
    send.add_argument("schema", type=Path, metavar="SCHEMA")
    send.add_argument("files", nargs="*", type=Path, metavar="FILE", help="bitstreams and overlays that it names")
    add_board_options(send, run_send)
    remove = actions.add_parser("remove", help="remove a configuration that a client sent")
    completes(remove.add_argument("config", metavar="CONFIG"), "<config>")
    add_board_options(remove, run_remove)


def _add_check(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    check = actions.add_parser(
        "check",
        help="check runtime schemas",
        description="Check runtime schemas. Exit status 0 if all are good. A folder stands for its *.yaml and *.yml"
        " files that have a config:, and - for what is on stdin.",
    )
    check.add_argument("paths", nargs="*", type=Path, metavar="FILE", help="a runtime schema, a folder of them, or -")
    check.add_argument("--settings", action="store_true", help="the files are settings of the service, such as cm.yaml")
    check.add_argument("--print-schema", action="store_true", help="print the JSON Schema for editors, and exit")
    add_json_option(check, run_check)
    check.set_defaults(usage_error=check.error)


def _add_rollback(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    rollback = actions.add_parser(
        "rollback",
        help="switch to an earlier version, in one step",
        description="Switch to an earlier version. A running manager takes it over when it is restarted or gets "
        "SIGHUP (systemctl reload cm).",
    )
    completes(rollback.add_argument("config", metavar="CONFIG"), "<config>")
    rollback.add_argument(
        "--to", type=int, metavar="N", help="its number (default: the newest; 0 names those there are)"
    )
    rollback.add_argument(
        "--out", type=Path, metavar="DIR", default=_FIRMWARE, help=f"folder of the configurations ({_FIRMWARE})"
    )
    add_json_option(rollback, run_rollback)


def run_list(args: argparse.Namespace) -> int:
    """Print all configurations; the exit status."""
    with connected(args) as board:
        configs = [board.config(name) for name in board.configs]
        entries = {entry.name: entry for entry in board.config_entries()}
    found = [{**plain(c), "schema": None, **_origin(entries.get(c.name))} for c in configs]
    sent = any(entry.owner for entry in entries.values())
    rows = [
        (
            c.name,
            c.type,
            m.name,
            ", ".join(m.modules),
            *([entries[c.name].owner] if sent else []),
            "loaded" if c.mode == m.name else "",
        )
        for c in configs
        for m in c.modes
    ]
    return answer_table(args, found, rows, ("CONFIG", "TYPE", "MODE", "MODULES", *(["SENT BY"] if sent else []), ""))


def run_show(args: argparse.Namespace) -> int:
    """Print one configuration, the loaded one without a name; the exit status."""
    with connected(args) as board:
        config = board.config(args.config)
    if args.yaml:
        return answer(args, config.schema, config.schema.rstrip("\n"))
    rows = [
        ("mode", m.name, ", ".join(m.modules) + (" (loaded)" if m.name == config.mode else "")) for m in config.modes
    ]
    rows += [("register", r.name, r.doc) for r in config.registers]
    rows += [("stream", s.name, f"{s.direction} {'x'.join(map(str, s.shape))} {s.dtype}") for s in config.streams]
    rows += [("interrupt", i.name, i.doc) for i in config.interrupts]
    rows += [("memory", m.name, m.doc) for m in config.memories]
    return answer_table(args, plain(config), rows, (config.name, "NAME", ""))


def _origin(entry: ConfigEntry | None) -> dict[str, object]:
    return {"origin": entry.origin, "owner": entry.owner, "bytes": entry.bytes} if entry else {}


def run_send(args: argparse.Namespace) -> int:
    """Send it, say which files neither it nor the manager has, and list what the manager has then; the exit status."""
    with connected(args) as board:
        sent = board.provision(args.schema, *args.files)
        for note in dict.fromkeys(_missing(board, sent)):
            print(f"cm config: note: {note}", file=sys.stderr)
    return run_list(args)


def _missing(board: Board, config: ConfigInfo) -> Iterator[str]:
    """What the manager would refuse to load a mode for, as a file is nowhere."""
    for entry in board.config_entries():
        for mode in entry.modes if entry.name == config.name else ():
            try:
                board.plan(mode, config.name)
            except RequestFailed as refused:
                if refused.code == "file_missing":
                    yield str(refused)


def run_remove(args: argparse.Namespace) -> int:
    """Remove; the exit status."""
    with connected(args) as board:
        board.remove_config(args.config)
    if args.json:
        print_json({"removed": args.config})
    return 0


def run_check(args: argparse.Namespace) -> int:
    """Check; the exit status."""
    from cm.cli.config_check import run  # here: it reads schemas

    return run(args)


def run_rollback(args: argparse.Namespace) -> int:
    """Roll back; the exit status."""
    from cm.formats.importers import back

    with naming(args.out):
        done = back(args.out / args.config, args.to)
    told = {"config": done.config.name, "folder": str(done.folder), "files": list(done.files)}
    text = f"{done.folder}: an earlier version of {done.config.name} is in force, {len(done.files)} files"
    return answer(args, told, text)
