# SPDX-License-Identifier: Apache-2.0
"""``cm build init``: a first build schema."""

from __future__ import annotations

import argparse
from pathlib import Path

from cm.cli.build import add_define_option, add_parameter_option
from cm.cli.common import add_json_option, answer, naming
from cm.design.errors import BuildError
from cm.design.hdl.extract import Sources
from cm.design.init import DEFAULT_PART, init_text, what_is_missing
from cm.design.project.load import SCHEMA_FILE
from cm.design.zypr import zypr_text


def fill_init(parser: argparse.ArgumentParser) -> None:
    """Describe the action."""
    parser.add_argument(
        "files",
        nargs="+",
        type=Path,
        metavar="FILE",
        help="Verilog, SystemVerilog, VHDL, FuseSoC .core, IP-XACT component.xml, .xci",
    )
    parser.add_argument("--from", dest="kind", choices=("zypr",), help="FILE is a project file of zypr (JSON)")
    parser.add_argument("--output", "-o", type=Path, default=Path("build.yaml"), metavar="FILE")
    parser.add_argument("--name", help="name of the configuration (default: that of the folder)")
    parser.add_argument("--part", default=DEFAULT_PART, help=f"full part (default: {DEFAULT_PART})")
    parser.add_argument("--top", metavar="NAME", help="only this module")
    parser.add_argument("-I", "--include", action="append", default=[], type=Path, metavar="DIR", help="include folder")
    add_define_option(parser)
    add_parameter_option(parser)
    parser.add_argument(
        "--cores",
        type=Path,
        action="append",
        default=[],
        metavar="DIR",
        help="folder to search for the cores that a .core depends on",
    )
    add_json_option(parser, run_init)


def run_init(args: argparse.Namespace) -> int:
    """Write the schema, and its JSON Schema for editors beside it; a file that is there is not overwritten."""
    output: Path = args.output
    if output.exists():
        raise BuildError(f"{output} exists already; give another name with --output")
    folder = output.absolute().parent
    if args.kind == "zypr":
        if len(args.files) != 1:
            raise BuildError("--from zypr takes one project file")
        text = zypr_text(args.files[0], folder)
    else:
        name = args.name or folder.name
        wanted = Sources(args.files, args.top, args.include, dict(args.define), dict(args.parameter))
        text = init_text(wanted, folder, name, args.part, args.cores)
    folder.mkdir(parents=True, exist_ok=True)
    with naming(output):
        output.write_text(text, encoding="utf-8")
    editor = folder / SCHEMA_FILE.name
    if not editor.exists():
        editor.write_bytes(SCHEMA_FILE.read_bytes())
    missing = what_is_missing(output.absolute())
    lines = [f"{output}: written; look it through, then: cm build check {output}"]
    lines += [f"not known: {sentence}" for sentence in missing]
    return answer(args, {"schema": str(output), "editor": str(editor), "unknown": missing}, "\n".join(lines))
