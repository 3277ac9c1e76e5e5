# SPDX-License-Identifier: Apache-2.0
"""Whatever a file contains, extraction gives modules or says what is wrong."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

pytest.importorskip("pyslang")
pytest.importorskip("tree_sitter_vhdl")

from hdl_support import DATA, extract

from cm.design.boundary.make import boundary
from cm.design.hdl.errors import HdlError
from cm.design.hdl.model import ModuleInfo

SETTINGS = settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
SEEDS = {path.suffix: path.read_bytes() for path in (DATA / "tagged.v", DATA / "unflat.sv", DATA / "filter.vhd")}
WORDS = (DATA / "words.txt").read_text().split()


def attempt(path: Path, name: str, data: bytes) -> list[ModuleInfo]:
    """Extract from these bytes; every port must be accounted for exactly once."""
    (path / name).write_bytes(data)
    try:
        modules = extract([path / name])
    except HdlError:
        return []
    for module in modules:
        told = [port for interface in module.interfaces for port in interface.ports.values()]
        told += [c.port for c in module.clocks] + [r.port for r in module.resets] + [i.port for i in module.interrupts]
        told += [left.port for left in module.leftovers]
        assert set(told) == {port.name for port in module.ports}
    return modules


@SETTINGS
@given(st.sampled_from([".v", ".sv", ".vhd"]), st.binary(max_size=300))
def test_any_bytes(tmp_path: Path, suffix: str, data: bytes) -> None:
    attempt(tmp_path, f"x{suffix}", data)


@SETTINGS
@given(st.sampled_from([".v", ".sv", ".vhd"]), st.lists(st.sampled_from(WORDS), max_size=40))
def test_any_words_of_the_languages(tmp_path: Path, suffix: str, words: list[str]) -> None:
    attempt(tmp_path, f"x{suffix}", " ".join(words).encode())


@SETTINGS
@given(st.sampled_from(sorted(SEEDS)), st.data())
def test_real_file_with_a_piece_cut_out_or_doubled(tmp_path: Path, suffix: str, data: st.DataObject) -> None:
    text = SEEDS[suffix]
    start = data.draw(st.integers(0, len(text)))
    end = data.draw(st.integers(start, min(len(text), start + 80)))
    piece = data.draw(st.sampled_from([b"", text[start:end] * 2, b"\xff\x00"]))
    modules = attempt(tmp_path, f"x{suffix}", text[:start] + piece + text[end:])
    for adaptation in boundary({module.name: module for module in modules}).adaptations:
        assert adaptation.ok or all(adaptation.refused)


@pytest.mark.parametrize("suffix", [".v", ".sv", ".vhd"])
def test_deep_nesting_terminates(tmp_path: Path, suffix: str) -> None:
    for text in ("(" * 20000, "module m; " + "begin " * 5000, "entity e is port (a : in bit_vector(" + "(" * 5000):
        attempt(tmp_path, f"x{suffix}", text.encode())


def test_ranges_of_absurd_size_terminate(tmp_path: Path) -> None:
    attempt(tmp_path, "x.v", b"module m (input [2**40:0] a, input [999999999999999999999:0] b); endmodule")
    attempt(tmp_path, "x.vhd", b"entity e is port (a : in bit_vector(2**4000 downto 0)); end;")
