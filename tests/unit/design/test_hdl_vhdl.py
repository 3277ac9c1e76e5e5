# SPDX-License-Identifier: Apache-2.0
"""Interfaces of VHDL entities, and the expressions in their ranges."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("tree_sitter_vhdl")

from hdl_support import DATA, extract

from cm.design.hdl.errors import HdlError
from cm.design.hdl.extract import Sources, read
from cm.design.hdl.model import Language, ModuleInfo, PortDirection
from cm.design.hdl.vhdl_expr import NotFlat, Unknown, evaluate, width_of


def entity(path: Path, ports: str, generics: str = "", before: str = "") -> ModuleInfo:
    """The only entity of a text, with these ports."""
    head = f"generic ({generics});" if generics else ""
    (path / "e.vhd").write_text(f"{before}\nentity e is {head}\nport (\n{ports}\n);\nend entity;\n")
    return extract([path / "e.vhd"])[0]


def test_entity_with_streams_package_types_and_attributes_is_read_completely() -> None:
    kernel_last = extract([DATA / "filter.vhd"])
    assert [m.name for m in kernel_last] == ["Filter", "filter_kernel"]
    found = kernel_last[0]
    assert found.language is Language.VHDL
    streams = [(i.name, i.protocol, i.mode.value, i.data_width, i.clock, i.reset) for i in found.interfaces]
    assert streams == [
        ("s_axis", "axis", "slave", 32, "S_AXIS_ACLK", "S_AXIS_ARESETN"),
        ("m_axis", "axis", "master", 32, "S_AXIS_ACLK", "S_AXIS_ARESETN"),
    ]
    assert found.instantiates == ("filter_kernel",)
    assert [i.port for i in found.interrupts] == ["done"]


def test_widths_are_evaluated_from_generics_functions_and_both_directions() -> None:
    found = extract([DATA / "filter.vhd"], top="filter", parameters={"C_DEPTH": "1024"})[0]
    assert found.port("level").width == 11
    assert found.port("address").width == 8
    assert {p.name: p.value for p in found.parameters} == {
        "C_ADDR_BITS": 7,
        "C_BASE": format(0x40000000, "032b"),
        "C_DEPTH": 1024,
    }


def test_records_and_integers_need_a_flat_wrapper() -> None:
    found = extract([DATA / "filter.vhd"], top="Filter")[0]
    assert {port.name for port in found.ports if not port.flat} == {"debug", "count"}
    assert not found.usable


def test_comments_and_strings_do_not_confuse(tmp_path: Path) -> None:
    found = entity(
        tmp_path, "a : in bit; -- b : in bit;\n c : in bit /* d : in bit */ ; e2 : out bit", before="-- entity x is"
    )
    assert [port.name for port in found.ports] == ["a", "c", "e2"]


def test_directions_buffers_and_defaults_are_read(tmp_path: Path) -> None:
    found = entity(tmp_path, "a, b : std_logic := '1'; signal c : buffer std_logic; d : inout std_logic_vector(1 to 4)")
    directions = [(p.name, p.direction, p.width, p.default) for p in found.ports]
    assert directions == [
        ("a", PortDirection.IN, 1, "'1'"),
        ("b", PortDirection.IN, 1, "'1'"),
        ("c", PortDirection.OUT, 1, ""),
        ("d", PortDirection.INOUT, 4, ""),
    ]


def test_an_attribute_may_be_of_several_signals_and_its_value_in_pieces(tmp_path: Path) -> None:
    said = 'attribute X_INTERFACE_PARAMETER of a_clk, B_CLK : signal is "FREQ_HZ " & "100";'
    (tmp_path / "e.vhd").write_text(f"entity e is port (a_clk, b_clk : in bit);\n{said}\nend entity;\n")
    (found,) = extract([tmp_path / "e.vhd"])
    assert [(clock.port, clock.frequency_hz) for clock in found.clocks] == [("a_clk", 100), ("b_clk", 100)]


def test_line_of_a_port_is_that_of_the_source(tmp_path: Path) -> None:
    found = entity(tmp_path, "a : in bit;\n b : in bit", before="-- first\n-- second")
    assert [port.line for port in found.ports] == [5, 6]


def test_range_without_a_value_is_a_problem_that_names_the_generic(tmp_path: Path) -> None:
    found = entity(tmp_path, "a : in std_logic_vector(N-1 downto 0)", generics="N : integer")
    assert found.port("a").width is None
    assert any("-P N=" in str(problem) for problem in found.problems)


@pytest.mark.parametrize(
    ("kind", "good", "wrong"),
    [
        ("natural range 1 to 8", ("1", "8"), ("0", "9", "1.5", "true")),
        ("integer range TOP downto -2", ("-2", "16#10#"), ("-3", "17")),
        ("positive", ("1",), ("0",)),
        ("work.p.tap_t", ("3",), ("2", "5")),
        ("natural range 0 to f(3)", ("900",), ("-1",)),
        ("real", ("-1.5",), ()),
        ("std_logic_vector(3 downto 0)", ("10",), ()),
    ],
)
def test_a_generic_takes_only_values_of_its_type(
    kind: str, good: tuple[str, ...], wrong: tuple[str, ...], tmp_path: Path
) -> None:
    types = (
        "constant TOP : natural := 16; subtype four_t is natural range 0 to 4; subtype tap_t is four_t range 3 to 9;"
    )
    (tmp_path / "e.vhd").write_text(
        f"package p is {types} end package;\nentity e is generic (N : {kind} := 3); port (a : in bit); end entity;\n"
    )
    for value in good:
        extract([tmp_path / "e.vhd"], parameters={"n": value})
    for value in wrong:
        with pytest.raises(HdlError, match=f"N={value}: the generic N of e is "):
            extract([tmp_path / "e.vhd"], parameters={"n": value})


def test_file_without_an_entity_is_reported(tmp_path: Path) -> None:
    (tmp_path / "a.vhd").write_text("architecture a of b is begin end;")
    with pytest.raises(HdlError, match="no entity in this file"):
        extract([tmp_path / "a.vhd"])


def test_both_languages_in_one_call_keep_the_order_of_the_files() -> None:
    pytest.importorskip("pyslang")
    assert [m.name for m in extract([DATA / "tagged.v", DATA / "filter.vhd"])] == ["tagged", "Filter", "filter_kernel"]


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("8/3", 2),
        ("-7/2", -3),
        ("(-7) mod 4", 1),
        ("(-7) rem 4", -3),
        ("2**10-1", 1023),
        ("-2**2", -4),
        ("16#FF#", 255),
        ("1_000", 1000),
        ("1e3", 1000),
        ('X"a5"', "10100101"),
        ("integer(ceil(log2(real(1000))))", 10),
        ("clog2(1)", 0),
        ("maximum(3, work.types.n)", 4),
        ("not (2 > 1 and true)", False),
        ('"ab" & "cd"', "abcd"),
        ("abs (2 - 5)", 3),
        ("7 / (-2) + (-7) / (-2)", 0),
        ("7.0 / 2.0", 3.5),
        ("integer(2.5) + natural(1.4)", 4),
        ("floor(2.7) + log2(8.0) + ieee.math_real.ceil(1.2)", 7.0),
        ("minimum(2, 3) * 100 + max(2, 3) * 10 + ceil_log2(9)", 234),
        ("n >= 4 and n <= 4 and not (n < 4) and not (n > 4)", True),
        ("5 = 5 xor 5 /= 5", True),
        ("FALSE or (true and false)", False),
        ("-n + (+n)", 0),
        ("2.0**2", 4.0),
        ("2#1_0# + 1.5e1", 17.0),
        ('O"17" & B"1_0" & X""', "00111110"),
        ('6UX"3" & 6sx"8" & 2x"7" & D"5"', "000011" + "111000" + "11" + "101"),
        ("""'"' & "a""b" & 1""", '"a"b1'),
    ],
)
def test_expression_has_the_value_that_the_standard_gives_it(text: str, value: object) -> None:
    assert evaluate(text, {"n": 4}) == value


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "a value is missing"),
        *((text, f"{text!r} is not understood") for text in ("1 +", "n n", "(1", "$", 'x"g"')),
        ("f(2)", "the function f is not evaluated"),
        ("work.p.n(3)", "the function n is not evaluated"),
        ("a'length", "a'length is not evaluated"),
        ("work.p.m", "the value of work.p.m is not known"),
        ("1/0", "1/0: integer division or modulo by zero"),
        ("log2(0.0)", "log2(0.0): math domain error"),
        ("clog2(0)", "logarithm of a number below 1"),
        ("10**99999", "power too large"),
        ("2**0.5**900000", "power too large"),
        ("1e99999", "1e99999 is too large"),
        ('-"a"', "- of 'a'"),
        ("not 3", "not of 3"),
        ("1 sll 2", "sll of 1 and 2"),
        ("true and 1", "and of True and 1"),
    ],
)
def test_expression_without_a_value_is_unknown(text: str, why: str) -> None:
    with pytest.raises(Unknown) as unknown:
        evaluate(text, {"n": 1})
    assert str(unknown.value) == why


@pytest.mark.parametrize(
    ("indication", "width"),
    [
        ("ieee.std_logic_1164.STD_LOGIC", 1),
        ("std_logic_vector(7 downto n)", 4),
        ("unsigned (n TO 7)", 4),
        ("signed(3 downto 4)", 0),
        ("byte", 8),
        ("std_logic_vector(16777215 downto 0)", 1 << 24),
    ],
)
def test_a_subtype_has_the_width_of_its_range(indication: str, width: int) -> None:
    assert width_of(indication, {"n": 4}, {"byte": "octet", "octet": "bit_vector(0 to 7)"}) == width


@pytest.mark.parametrize(
    ("indication", "flat", "why"),
    [
        ("std_logic_vector(16777216 downto 0)", True, "its range 16777216 downto 0 is too wide"),
        ("std_logic_vector(m downto 0)", True, "the value of m is not known"),
        ("std_logic_vector(1.5 downto 0)", True, "1.5 is not an integer"),
        ("std_logic_vector(true downto 0)", True, "true is not an integer"),
        ("std_logic_vector", False, "its type std_logic_vector has no range that could be evaluated"),
        ("std_logic_vector(index)", False, "has no range that could be evaluated: needs a flat wrapper"),
        ("work.types.pixel", False, "its type work.types.pixel is not a vector of std_logic: needs a flat wrapper"),
        ("loop_", False, "its type loop_ needs a flat wrapper"),
    ],
)
def test_a_subtype_without_a_width_says_whether_any_generic_gives_it_one(indication: str, flat: bool, why: str) -> None:
    with pytest.raises(Unknown) as unknown:
        width_of(indication, {}, {"loop_": "loop_"})
    assert why in str(unknown.value)
    assert isinstance(unknown.value, NotFlat) != flat


@given(st.text(alphabet="0123456789()+-*/ ndownto'\"#&=<>,.xX_e", max_size=40))
def test_no_expression_does_anything_but_have_a_value_or_be_unknown(text: str) -> None:
    try:
        evaluate(text, {"n": 3})
    except Unknown:
        return


@given(st.integers(0, 10**6), st.integers(1, 10**3), st.integers(-(10**6), 10**6))
def test_integer_arithmetic_is_exact(a: int, b: int, c: int) -> None:
    assert evaluate(f"{a} / {b} * {b} + {a} rem {b}", {}) == a
    assert evaluate(f"({c}) mod {b} + n", {"n": 1}) == c % b + 1


def test_a_subtype_without_a_range_takes_that_of_its_use() -> None:
    subtypes = {"slv": "std_logic_vector", "word": "std_logic_vector(31 downto 0)"}
    assert [width_of(text, {}, subtypes) for text in ("slv(7 downto 0)", "work.types.slv(0 to 2)", "word")] == [
        8,
        3,
        32,
    ]


def test_a_generic_that_no_port_needs_is_asked_for_only_if_it_has_no_default(tmp_path: Path) -> None:
    generics = "DELAY : time := 1 ns; SEED : integer; BITS : natural := pick(3)"
    found = entity(tmp_path, "a : in std_logic_vector(BITS - 1 downto 0)", generics)
    asked = [problem.message.split()[1] for problem in found.problems if problem.message.startswith("generic ")]
    assert asked == ["SEED", "BITS"]


def test_a_port_may_take_the_range_of_a_generic(tmp_path: Path) -> None:
    start = "start : std_ulogic_vector(width - 1 downto 0) := (others => '0')"
    generics = f'width : positive := 8; {start}; poly : bits := "101"'
    two = "b : in bit_vector(poly'length downto 1); c : out unsigned(start'length downto 0)"
    ports = f"a : in std_ulogic_vector(start'range); {two}"
    assert [port.width for port in entity(tmp_path, ports, generics).ports] == [8, 3, 9]


def test_a_constant_may_need_one_of_a_later_package(tmp_path: Path) -> None:
    before = "package a is constant W : positive := LATER * 2; end package;\n"
    before += "package b is constant LATER : natural := 4; end package;"
    assert entity(tmp_path, "p : in std_logic_vector(W - 1 downto 0)", before=before).port("p").width == 8


def test_the_files_of_an_entity_are_those_of_what_it_instantiates(tmp_path: Path) -> None:
    inner = "entity inner is port (a : in bit); end entity;\narchitecture rtl of inner is begin end architecture;\n"
    outer = "entity outer is port (a : in bit); end entity;\narchitecture rtl of outer is begin\n"
    outer += "  one : entity work.inner port map (a => a);\nend architecture;\n"
    files = [tmp_path / name for name in ("inner.vhd", "other.vhd", "outer.vhd")]
    for file, text in zip(files, (inner, inner.replace("inner", "other"), outer), strict=True):
        file.write_text(text)
    assert read(Sources(files)).files["outer"] == (files[0], files[2])
