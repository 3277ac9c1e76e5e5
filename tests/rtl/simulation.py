# SPDX-License-Identifier: Apache-2.0
"""Builds a design with Icarus Verilog and runs the tests of a cocotb module in it."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
from xml.etree import ElementTree

import pytest

HERE = Path(__file__).parent


def simulate(
    top: str,
    sources: list[Path],
    module: str,
    folder: Path,
    only: str = "",
    parameters: dict[str, int] | None = None,
    **environment: str,
) -> list[str]:
    """The names of the tests that ran; fails with what the simulator said if one of them failed."""
    runner_module = pytest.importorskip("cocotb_tools.runner", reason="needs cocotb, which is not installed")
    pytest.importorskip("cocotbext.axi", reason="needs cocotbext-axi, which is not installed")
    runner = runner_module.get_runner("icarus")
    log = folder / "simulation.log"
    runner.build(
        sources=sources,
        hdl_toplevel=top,
        parameters=parameters or {},
        build_dir=folder,
        always=True,
        timescale=("1ns", "1ps"),
        log_file=folder / "build.log",
    )
    path = os.pathsep.join([str(HERE), os.environ.get("PYTHONPATH", "")])
    results = folder / "results.xml"
    with contextlib.suppress(SystemExit):  # how the runner tells of failed tests; the file says more
        runner.test(
            hdl_toplevel=top,
            test_module=module,
            test_filter=only or None,
            build_dir=folder,
            test_dir=folder,
            log_file=log,
            results_xml=str(results),
            extra_env={"PYTHONPATH": path, "PYTHONWARNINGS": "ignore", **environment},
        )
    assert results.exists(), log.read_text(errors="replace")[-3000:]
    cases = [case for case in ElementTree.parse(results).iter("testcase") if case.find("skipped") is None]
    wrong = {
        str(case.get("name")): found.text for case in cases for found in case.findall("failure") + case.findall("error")
    }
    assert not wrong, "\n".join(f"{name}: {text}" for name, text in wrong.items())[-6000:]
    assert cases
    return [str(case.get("name")) for case in cases]
