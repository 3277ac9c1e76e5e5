# SPDX-License-Identifier: Apache-2.0
"""Streams by other names: valid, data and acknowledge, in VHDL with packages, are asked for and decided by a line."""

from __future__ import annotations

from pathlib import Path

import pytest

from cm.cli.main import main
from cm.design.project.load import load_project

pytest.importorskip("tree_sitter_vhdl", reason="needs tree-sitter-vhdl: the extra [build] is not installed")

ENTITY = """library work;
use work.widths.all;
entity relay is
  generic (BITS : positive := 32);
  port (
    Clock, Reset : in std_logic;
    In_Valid : in std_logic; In_Data : in std_logic_vector(BITS - 1 downto 0);
    In_EOF : in std_logic; In_Ack : out std_logic;
    Out_Valid : out std_logic; Out_Data : out T_BYTE; Out_EOF : out std_logic; Out_Ack : in std_logic;
    Out_Meta_rst : in std_logic
  );
end entity;
"""
PACKAGE = "package widths is\n  subtype T_BYTE\t\tis std_logic_vector(7 downto 0);\nend package;\n"


def read(folder: Path, streams: str, entity: str = ENTITY) -> str:
    """What `check` says of a module with such streams."""
    (folder / "relay.vhd").write_text(entity)
    (folder / "widths.vhd").write_text(PACKAGE)
    (folder / "build.yaml").write_text(
        "project: {name: relay, part: xc7z020clg400-1}\n"
        "regions: {prr0: {pblock: auto, resources: {lut: 500}}}\n"
        f"modules: {{relay: {{sources: [widths.vhd, relay.vhd], resources: {{lut: 50}}{streams}}}}}\n"
    )
    return str(main(["build", "check", str(folder / "build.yaml")]))


def test_a_stream_that_is_acknowledged_is_asked_for(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert read(tmp_path, "") != "0"
    out = capsys.readouterr().out
    assert "looks like a stream that In_Ack acknowledges" in out
    assert "write streams: [In, Out] in the module, else []" in out


def test_one_line_makes_it_a_stream(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert read(tmp_path, ", streams: [In, Out]") == "0"
    out = capsys.readouterr().out
    assert "In: axis slave, 32 bits" in out
    assert "Out: axis master, 8 bits" in out
    assert "goes with the stream Out" in out


def test_a_name_that_is_no_stream_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert read(tmp_path, ", streams: [In, Aut]") != "0"
    assert "streams: names aut, of which relay has no valid, data and ack that fit" in capsys.readouterr().out


FIFO = """entity relay is
  port (
    clk, rst : in std_logic;
    put : in std_logic; din : in std_logic_vector(7 downto 0); full : out std_logic;
    got : in std_logic; dout : out std_logic_vector(7 downto 0); valid : out std_logic
  );
end entity;
"""


def test_the_sides_of_a_fifo_are_asked_for(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert read(tmp_path, "", FIFO) != "0"
    out = capsys.readouterr().out
    assert "a stream with TVALID put, TDATA din and TREADY not full" in out
    assert "a stream with TVALID valid, TDATA dout and TREADY got" in out
    read(tmp_path, ", streams: []", FIFO)
    assert "side of a FIFO" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("named", "said"),
    [
        ("vld_i : in std_logic; dat_i : in bit_vector(3 downto 0)", "a stream without ready: streams: [i]"),
        ("o_valid : out bit; i_ready : in bit; o_data : out bit_vector(3 downto 0)", "write streams: [o] in"),
        ("a_pvld : in bit; a_prdy : out bit; a_pd : in bit_vector(3 downto 0)", "write streams: [a] in"),
        ("wr_en_i : in bit; wr_data_i : in bit_vector(3 downto 0); wfull_o : out bit", "is like a FIFO"),
        ("x_read : in bit; x_data : out bit_vector(3 downto 0); x_empty : out bit", "is like a FIFO"),
    ],
)
def test_what_these_are_like_is_said(named: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    read(tmp_path, "", f"entity relay is port (clk, rst : in bit; {named}); end entity;")
    assert said in " ".join(capsys.readouterr().out.split())


PIXELS = """entity relay is
  port (
    clk, rst : in std_logic;
    pix_data : in std_logic_vector(7 downto 0); pix_valid : in std_logic; pix_ready : out std_logic
  );
end entity;
"""


def test_data_valid_and_ready_are_asked_for_and_stated_by_a_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert read(tmp_path, "", PIXELS) != "0"
    assert "looks like a stream that pix_ready acknowledges" in capsys.readouterr().out
    assert read(tmp_path, ", streams: [pix]", PIXELS) == "0"
    assert "pix: axis slave, 8 bits" in capsys.readouterr().out


def test_init_proposes_them_as_streams(tmp_path: Path) -> None:
    (tmp_path / "relay.vhd").write_text(PIXELS)
    assert main(["build", "init", str(tmp_path / "relay.vhd"), "-o", str(tmp_path / "build.yaml")]) == 0
    assert load_project(tmp_path / "build.yaml").modules["relay"].streams == ("pix",)
