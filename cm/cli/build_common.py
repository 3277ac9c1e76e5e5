# SPDX-License-Identifier: Apache-2.0
"""What the actions of ``cm build`` share."""

from __future__ import annotations

import argparse
from pathlib import Path


def add_schema_argument(parser: argparse.ArgumentParser) -> None:
    """The build schema."""
    parser.add_argument(
        "schema", nargs="?", type=Path, default=Path("build.yaml"), metavar="SCHEMA", help="default: build.yaml"
    )


def add_out_option(parser: argparse.ArgumentParser) -> None:
    """The output folder."""
    parser.add_argument("--out", type=Path, metavar="DIR", help="output folder (default: build/ beside the schema)")
