# SPDX-License-Identifier: Apache-2.0
"""``cm build …``: from HDL to bitstreams, overlays and runtime schemas."""

from __future__ import annotations

import argparse

from cm.cli.build_collect import add_collect_parser
from cm.cli.build_generate import add_check_parser, add_configure_parser, add_generate_parser, add_init_parser
from cm.cli.build_interfaces import add_interfaces_parser
from cm.cli.build_partition import add_partition_parser
from cm.cli.build_run import add_pack_parsers, add_run_parser, add_tools_parser

_DESCRIPTION = (
    "The build tool. `init` writes a first build schema, `check` reports what it finds in "
    "the HDL, `generate` writes everything that the vendor's tools and the target need, "
    "`configure` asks for decisions that only you can make, `run` runs the flow (with "
    "`pack` and `unpack` on another host), and `collect` packs the results for the target."
    " Most take the name of the build schema, by default build.yaml."
)


def fill_parser(parser: argparse.ArgumentParser) -> None:
    """Describe the command."""
    parser.description = _DESCRIPTION
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    add_init_parser(actions)
    add_interfaces_parser(actions)
    add_check_parser(actions)
    add_generate_parser(actions)
    add_configure_parser(actions)
    add_run_parser(actions)
    add_pack_parsers(actions)
    add_collect_parser(actions)
    add_partition_parser(actions)
    add_tools_parser(actions)
