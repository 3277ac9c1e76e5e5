# SPDX-License-Identifier: Apache-2.0
"""``cm configs``: the configurations and their modes; ``cm configs --send``: provision one."""

from __future__ import annotations

import argparse
from pathlib import Path

from cm.cli.client import connected, plain
from cm.cli.common import add_connection_options, add_json_option, print_json, print_table
from cm.wire.messages.status import ConfigEntry


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command."""
    parser = subparsers.add_parser("configs", help="list the configurations and their modes")
    add_connection_options(parser)
    add_json_option(parser)
    parser.add_argument(
        "--send",
        nargs="+",
        type=Path,
        metavar=("SCHEMA", "FILE"),
        help="first send a schema file and the bitstreams and overlays that belong to it",
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print all configurations; the exit status."""
    with connected(args) as board:
        if args.send:
            board.provision(args.send[0], *args.send[1:])
        configs = [board.config(name) for name in board.configs]
        entries = {entry.name: entry for entry in board.config_entries()}
    if args.json:
        print_json([{**plain(c), "schema": None, **_origin(entries.get(c.name))} for c in configs])
        return 0
    sent = any(entry.owner for entry in entries.values())
    rows = [
        (
            c.name,
            c.type,
            m.name,
            ", ".join(m.modules),
            *([entries[c.name].owner] if sent else []),
            _mark(c.mode, m.name),
        )
        for c in configs
        for m in c.modes
    ]
    print_table(rows, ("CONFIG", "TYPE", "MODE", "MODULES", *(["SENT BY"] if sent else []), ""))
    return 0


def _origin(entry: ConfigEntry | None) -> dict[str, object]:
    return {"origin": entry.origin, "owner": entry.owner, "bytes": entry.bytes} if entry else {}


def _mark(current: str, mode: str) -> str:
    return "loaded" if current == mode else ""
