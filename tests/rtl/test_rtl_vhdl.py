# SPDX-License-Identifier: Apache-2.0
"""Modules in VHDL behind the simulated nodes, by ghdl's synthesis."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from conftest import HERE, needs
from headless_rig import running

from cm.simulation.rtl.design import load_rtl_design
from cm.simulation.rtl.errors import RtlError, ToolMissing

DIM = HERE / "dim"
pytestmark = [needs("verilator"), needs("g++"), needs("ghdl"), pytest.mark.timeout(300)]
MODELS: dict[str, Callable[[np.ndarray], np.ndarray]] = {"dim": lambda x: x >> 1, "negative": lambda x: ~(x >> 3)}


def test_an_entity_runs_with_its_generics_and_the_package_of_its_library(tmp_path: Path) -> None:
    data = np.arange(256, dtype=np.uint8)
    with running(DIM / "build.yaml", tmp_path) as board:
        for name, model in MODELS.items():
            board.load(name)
            assert np.array_equal(board.picture(data, 512), model(data))


def copied(folder: Path, old: str, new: str) -> Path:
    shutil.copytree(DIM, folder / "dim")
    source = folder / "dim/hdl/dim.vhd"
    text = source.read_text()
    assert old in text
    source.write_text(text.replace(old, new))
    return folder / "dim/build.yaml"


def test_an_error_in_vhdl_is_reported_with_its_line(tmp_path: Path) -> None:
    schema = copied(tmp_path, "weaken(S_AXIS_TDATA, SHIFT);", "weaken(S_AXIS_TDATA, no_such_thing);")
    with pytest.raises(RtlError, match=r"module dim: ghdl.*\n.*dim.vhd:\d+:\d+.*no_such_thing"):
        load_rtl_design(schema, tmp_path / "tree")


def test_a_module_in_two_languages_is_refused_by_name(tmp_path: Path) -> None:
    schema = copied(tmp_path, "Darker", "Darker")
    (tmp_path / "dim/hdl/other.v").write_text("module other(input wire a); endmodule\n")
    schema.write_text(schema.read_text().replace("[hdl/dim.vhd]", "[hdl/dim.vhd, hdl/other.v]"))
    with pytest.raises(RtlError, match=r"module dim is in two languages.*other\.v"):
        load_rtl_design(schema, tmp_path / "tree")


def test_without_ghdl_the_message_says_how_to_get_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CM_GHDL", "no-such-ghdl")
    with pytest.raises(ToolMissing, match="apt-get install ghdl"):
        load_rtl_design(DIM / "build.yaml", tmp_path)
