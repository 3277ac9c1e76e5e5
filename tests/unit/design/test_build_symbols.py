# SPDX-License-Identifier: Apache-2.0
"""Register symbols, recipes and other languages' modules."""

from __future__ import annotations

import importlib.util
import re
import subprocess
from pathlib import Path

import pytest
from build_support import AXIL_MODULE, MINIMAL, NAMES, copy_examples, generated, needs, project

from cm import schema
from cm.design.generate.generation import generate, load_design

VHDL = """\
library ieee;
use ieee.std_logic_1164.all;

entity pass is
  generic (WIDTH : integer := 16);
  port (
    aclk          : in  std_logic;
    aresetn       : in  std_logic;
    s_axis_tdata  : in  std_logic_vector(WIDTH - 1 downto 0);
    s_axis_tvalid : in  std_logic;
    s_axis_tready : out std_logic;
    m_axis_tdata  : out std_logic_vector(WIDTH - 1 downto 0);
    m_axis_tvalid : out std_logic;
    m_axis_tready : in  std_logic
  );
end entity;
"""


@pytest.fixture(scope="module", params=NAMES)
def built(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Path]:
    return request.param, generated(copy_examples(tmp_path_factory.mktemp("symbols")), request.param)[1]


@needs("cc")
def test_the_c_header_compiles_and_has_the_addresses_of_the_schema(built: tuple[str, Path], tmp_path: Path) -> None:
    name, out = built
    config = schema.load(out / f"config/{name}.yaml")
    lines = [f'#include "{name}_registers.h"']
    for module in config.modules.values():
        for register in module.registers.values():
            prefix = f"{name}_{module.name}".upper()
            symbol = f"{prefix}_BASE + {prefix}_{register.name.upper()}"
            lines.append(f'_Static_assert({symbol} == {register.address:#x}, "{symbol}");')
    source = tmp_path / "check.c"
    source.write_text("\n".join(lines) + "\n")
    command = ["cc", "-std=c11", "-Wall", "-Wextra", "-Werror", "-fsyntax-only", f"-I{out / 'include'}", str(source)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_the_python_symbols_say_the_same(built: tuple[str, Path]) -> None:
    name, out = built
    spec = importlib.util.spec_from_file_location("symbols", out / f"python/{name}_registers.py")
    assert spec is not None
    assert spec.loader is not None
    symbols = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(symbols)
    config = schema.load(out / f"config/{name}.yaml")
    for module in config.modules.values():
        for register in module.registers.values():
            block = getattr(symbols, module.name.upper())
            assert block.BASE + getattr(block, register.name.upper()) == register.address


AWKWARD = (
    MINIMAL.replace("one:", "control:", 1).replace("sources: [one.v]", "sources: [one.v]\n    top: one")
    + """\
    doc: 'C:\\dir "here"'
    registers:
      base: {offset: 0x0, fields: {shift: {bits: 0}, mask: {bits: 3:1, values: {shift: 1}}}}
      base_shift: {offset: 0x4, doc: "first */ line\\nsecond"}
    memories:
      table: {offset: 0x80, size: 64, doc: coefficients}
"""
)


@needs("cc")
def test_symbols_are_there_once_whatever_names_and_words_a_schema_has(tmp_path: Path) -> None:
    pytest.importorskip("pyslang", reason="needs pyslang: the extra [build] is not installed")
    generate(load_design(project(tmp_path, AWKWARD, one=AXIL_MODULE)), tmp_path / "build")
    header = tmp_path / "build/include/small_registers.h"
    command = ["cc", "-std=c11", "-Wall", "-Wextra", "-Werror", "-fsyntax-only", "-x", "c", str(header)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    defined = dict(re.findall(r"#define SMALL_(\w+) (\w+)u", header.read_text()))
    assert (defined["CONTROL_BASE"], defined["CONTROL__BASE"], defined["CONTROL__BASE_"]) == (
        "0x40000000",
        "0x40010000",
        "0x00",
    )
    assert (defined["CONTROL__BASE_SHIFT_MASK"], defined["CONTROL__TABLE"]) == ("0x1", "0x80")
    found: dict[str, type] = {}
    exec((tmp_path / "build/python/small_registers.py").read_text(), found)
    assert (found["CONTROL"].BASE, found["CONTROL_"].BASE, found["CONTROL_"].BASE_SHIFT) == (0x40000000, 0x40010000, 4)
    assert found["CONTROL_"].__doc__ == 'C:\\dir "here"'


def test_the_recipe_installs_where_the_manager_looks(built: tuple[str, Path]) -> None:
    name, out = built
    (recipe,) = (out / "yocto").rglob("*.bb")
    text = recipe.read_text()
    assert f'CM_CONFIG = "{name}"\ninherit cm-bundle' in text
    bundle = (Path(__file__).parents[3] / "yocto/meta-cm/classes/cm-bundle.bbclass").read_text()
    assert "install -d ${D}${nonarch_base_libdir}/firmware/cm/${CM_CONFIG}" in bundle
    assert re.search(rf'SRC_URI = "file://{name}\.tar\.gz', text)
    assert 'WORKDIR}"\n' not in text.replace('UNPACKDIR ??= "${WORKDIR}"\n', "")


def test_a_vhdl_entity_is_wrapped_and_read_as_vhdl(tmp_path: Path) -> None:
    pytest.importorskip("tree_sitter_vhdl", reason="needs tree-sitter-vhdl: the extra [build] is not installed")
    pytest.importorskip("pyslang", reason="needs pyslang: the extra [build] is not installed")
    (tmp_path / "pass.vhd").write_text(VHDL)
    text = MINIMAL.replace(
        "  one:\n    sources: [one.v]", "  pass:\n    sources: [pass.vhd]\n    parameters: {WIDTH: 32}"
    )
    design = load_design(project(tmp_path, text))
    generate(design, tmp_path / "build")
    wrapper = (tmp_path / "build/wrappers/pass/cm_region_prr0.v").read_text()
    assert ".WIDTH(32)" in wrapper
    assert "input  wire [31:0] s_axis_tdata" in wrapper
    assert 'read_vhdl -vhdl2008 "$cm_source/pass.vhd"' in (tmp_path / "build/tcl/step_synth_pass.tcl").read_text()
    assert any("no TLAST" in note for note in design.system.notes)
