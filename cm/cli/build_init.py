# SPDX-License-Identifier: Apache-2.0
"""``cm build init FILE…``: write a first build schema."""

from __future__ import annotations

import argparse
from pathlib import Path

from cm.cli.common import add_json_option, print_json
from cm.design.errors import BuildError
from cm.design.init import DEFAULT_PART, init_text
from cm.design.project.load import SCHEMA_FILE


def add_init_parser(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the action."""
    parser = actions.add_parser("init", help="write a first build schema for HDL files")
    parser.add_argument(
        "files",
        nargs="+",
        type=Path,
        metavar="FILE",
        help="Verilog, SystemVerilog, VHDL, FuseSoC .core, IP-XACT component.xml, .xci",
    )
    parser.add_argument("--output", "-o", type=Path, default=Path("build.yaml"), metavar="FILE")
    parser.add_argument("--name", help="name of the configuration (default: that of the folder)")
    parser.add_argument("--part", default=DEFAULT_PART, help=f"full part (default: {DEFAULT_PART})")
    parser.add_argument("--top", metavar="NAME", help="only this module")
    parser.add_argument(
        "--cores",
        type=Path,
        action="append",
        default=[],
        metavar="DIR",
        help="folder to search for the cores that a .core depends on",
    )
    add_json_option(parser)
    parser.set_defaults(run=run_init)


def run_init(args: argparse.Namespace) -> int:
    """Write the schema, and its JSON Schema for editors beside it; a file that is there is not overwritten."""
    output: Path = args.output
    if output.exists():
        raise BuildError(f"{output} exists already; give another name with --output")
    folder = output.absolute().parent
    text = init_text(args.files, folder, args.name or folder.name, args.part, args.top, args.cores)
    folder.mkdir(parents=True, exist_ok=True)
    output.write_text(text, encoding="utf-8")
    editor = folder / SCHEMA_FILE.name
    if not editor.exists():
        editor.write_bytes(SCHEMA_FILE.read_bytes())
    if args.json:
        print_json({"schema": str(output), "editor": str(editor)})
    else:
        print(f"{output}: written; look it through, then: cm build check {output}")
    return 0
