# SPDX-License-Identifier: Apache-2.0
"""What the HDL says of its own inputs: defaults are kept, null ranges have no bits, subtypes keep their ranges."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("tree_sitter_vhdl", reason="needs tree-sitter-vhdl: the extra [build] is not installed")

from cm.cli.main import main

ENTITY = """library ieee; use ieee.std_logic_1164.all; use work.names.all;
entity relay is
  generic (BITS : natural := 0);
  port (
    aclk, aresetn : in sl;
    s_axis_tdata : in slv(7 downto 0); s_axis_tvalid : in sl; s_axis_tready : out sl;
    s_axis_tuser : in slv(BITS - 1 downto 0);
    m_axis_tdata : out slv(7 downto 0); m_axis_tvalid : out sl; m_axis_tready : in sl;
    run : in sl := '1';
    hold : in sl
  );
end entity;
architecture rtl of relay is
begin
  m_axis_tdata <= s_axis_tdata; m_axis_tvalid <= s_axis_tvalid and run and not hold; s_axis_tready <= m_axis_tready;
end architecture;
"""
PACKAGE = """library ieee; use ieee.std_logic_1164.all;
package names is
  subtype sl is std_logic; subtype slv is std_logic_vector;
end package;
"""


def written(folder: Path, interfaces: str = "") -> str:
    """The wrapper around the module, in a region with these `interfaces`."""
    (folder / "relay.vhd").write_text(ENTITY)
    (folder / "names.vhd").write_text(PACKAGE)
    (folder / "build.yaml").write_text(
        "project: {name: relay, part: xc7z020clg400-1}\n"
        f"regions: {{prr0: {{pblock: auto, resources: {{lut: 500}}{interfaces}}}}}\n"
        "modules: {relay: {sources: [names.vhd, relay.vhd], resources: {lut: 50}}}\n"
    )
    assert main(["build", "generate", str(folder / "build.yaml")]) == 0
    return (folder / "build/wrappers/relay/cm_region_prr0.v").read_text()


def test_an_input_that_nothing_drives_keeps_the_default_of_the_hdl(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = written(tmp_path)
    assert "run" not in text
    assert ".hold" in text
    assert main(["build", "check", str(tmp_path / "build.yaml")]) == 0
    said = capsys.readouterr().out
    assert "run: keeps its default" in said
    assert "note: prr0: hold: of no interface, driven by nothing, and 0;" in said


def test_an_input_with_a_default_is_driven_where_the_build_schema_names_it(tmp_path: Path) -> None:
    assert ".run" in written(tmp_path, ", interfaces: {run: {connect: none}}")


def test_a_null_range_is_no_port_of_the_wrapper(tmp_path: Path) -> None:
    text = written(tmp_path)
    assert "tuser" not in text
    assert "[7:0]" in text
