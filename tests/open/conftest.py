# SPDX-License-Identifier: Apache-2.0
"""The open tools: skipped where they cannot be fetched, and where yosys, Icarus or Verilator is not installed."""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent / "unit")]

from routed import TOOLS, Routed, route  # noqa: E402 - beside this file

from cm.build.packages import PackagesUnavailable, fetch  # noqa: E402
from cm.build.packages.tree import PackageTree  # noqa: E402


@pytest.fixture(scope="session")
def packages() -> PackageTree:
    """nextpnr, Project X-Ray and their data."""
    if os.environ.get("CM_OFFLINE"):
        pytest.skip("CM_OFFLINE: nextpnr and prjxray are not fetched")
    try:
        return fetch(TOOLS)
    except (PackagesUnavailable, OSError) as problem:
        pytest.skip(f"nextpnr and prjxray cannot be fetched: {problem}")


@pytest.fixture(scope="session")
def routed(packages: PackageTree, tmp_path_factory: pytest.TempPathFactory) -> Routed:
    """hdl/everything.v, placed and routed."""
    for program in ("yosys", "iverilog", "verilator"):
        if shutil.which(program) is None:
            pytest.skip(f"needs {program}, which is not installed")
    return route(packages, tmp_path_factory.mktemp("routed"))
