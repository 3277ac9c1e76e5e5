# SPDX-License-Identifier: Apache-2.0
"""``cm build …``: from HDL to bitstreams, overlays and runtime schemas."""

from __future__ import annotations

import argparse
import re
from functools import partial
from importlib import import_module
from pathlib import Path

from cm.cli.commands import missing

_DESCRIPTION = (
    "The build tool. `init` writes a first build schema, `check` reports what it finds in "
    "the HDL, `generate` writes everything that the vendor's tools and the target need, "
    "`configure` asks for decisions that only you can make, `run` runs the flow, and "
    "`collect` packs the results for the target."
    " Most take the name of the build schema, by default build.yaml."
)
# action → the module that has it, and its help; only the module of the action that is used is imported
_ACTIONS = {
    "init": ("init", "write a first build schema for HDL files"),
    "interfaces": ("interfaces", "find the bus interfaces of HDL modules"),
    "check": ("check", "report what was found in the HDL, and how the modules fit their regions"),
    "generate": ("generate", "write wrappers, static part, Tcl, overlays, symbols and the runtime schema"),
    "configure": ("generate", "ask for the decisions that the runtime schema needs"),
    "run": ("run", "run the flow, in Vivado or with open tools, as far as inputs have changed"),
    "collect": ("collect", "make a configuration for the target from bitstreams and hardware descriptions"),
    "partition": ("partition", "propose regions, and which modules share one"),
    "tools": ("run", "show which open tools are found, or fetch them"),
}
_ASSIGNMENT = re.compile(r"([A-Za-z_]\w*)(?:=(.*))?", re.DOTALL)


def fill_parser(parser: argparse.ArgumentParser) -> None:
    """Describe the command."""
    parser.description = _DESCRIPTION
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    for name, (module, about) in _ACTIONS.items():
        actions.add_parser(name, help=about, fill=partial(_fill, name, f"cm.cli.build_{module}"))


def _fill(name: str, module: str, parser: argparse.ArgumentParser) -> None:
    try:
        getattr(import_module(module), f"fill_{name}")(parser)
    except ImportError as error:
        raise missing("build", module, error) from error


def add_schema_argument(parser: argparse.ArgumentParser) -> None:
    """The build schema."""
    parser.add_argument(
        "schema", nargs="?", type=Path, default=Path("build.yaml"), metavar="SCHEMA", help="default: build.yaml"
    )


def add_out_option(parser: argparse.ArgumentParser) -> None:
    """The output folder."""
    parser.add_argument("--out", type=Path, metavar="DIR", help="output folder (default: build/ beside the schema)")


def add_define_option(parser: argparse.ArgumentParser) -> None:
    """Macros for the preprocessor."""
    parser.add_argument(
        "-D", "--define", action="append", default=[], type=assignment, metavar="NAME[=VALUE]", help="define a macro"
    )


def assignment(text: str) -> tuple[str, str]:
    """NAME=VALUE, or NAME alone, whose value is 1."""
    match = _ASSIGNMENT.fullmatch(text)
    if match is None:
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=VALUE")
    return match[1], match[2] if match[2] is not None else "1"


def add_parameter_option(parser: argparse.ArgumentParser) -> None:
    """Parameters of the top, or of the modules that have them."""
    parser.add_argument(
        "-P", "--parameter", action="append", default=[], type=_parameter, metavar="NAME=VALUE", help="set a parameter"
    )


def _parameter(text: str) -> tuple[str, str]:
    if "=" not in text:
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=VALUE")
    return assignment(text)
