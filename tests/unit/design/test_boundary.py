# SPDX-License-Identifier: Apache-2.0
"""A region's common boundary and how modules are fitted to it."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("pyslang")

from hdl_support import extract, lite, stream

from cm.design.boundary import make as making
from cm.design.boundary.model import Adaptation, Boundary, Connection, Fit, Role
from cm.design.boundary.slots import identifier, unique
from cm.design.hdl.model import FoundBy, Mode, ModuleInfo, Polarity
from cm.design.hdl.user_protocols import parse_protocols

CLOCKED = "input aclk; input aresetn; "


def boundary(modules: list[ModuleInfo]) -> Boundary:
    """The boundary of modules by their own names; what is connected to a port knows its width."""
    found = making.boundary({module.name: module for module in modules})
    for adaptation in found.adaptations:
        known = {c.boundary: c.boundary_width for c in adaptation.connections if c.boundary}
        assert known == {name: width for name, width in widths(found).items() if name in known}
    return found


@pytest.fixture
def make(tmp_path: Path):
    """A factory of modules: make("edge", "input a; output b")."""

    def factory(name: str, declarations: str, **options: object) -> ModuleInfo:
        text = ",\n".join(part.strip() for part in declarations.split(";") if part.strip())
        file = tmp_path / f"{name}.v"
        file.write_text(f"module {name} (\n{text}\n);\nendmodule\n")
        return extract([file], top=name, **options)[0]  # type: ignore[arg-type]

    return factory


def fits(adaptation: Adaptation) -> dict[str, Fit]:
    """Fit by boundary port."""
    return {c.boundary: c.fit for c in adaptation.connections if c.boundary}


def at(adaptation: Adaptation, boundary_port: str) -> Connection:
    """The connection at a boundary port."""
    return next(c for c in adaptation.connections if c.boundary == boundary_port)


def widths(result: Boundary) -> dict[str, int]:
    """Width by boundary port."""
    return {port.name: port.width for port in result.ports}


def test_equal_modules_connect_straight(make) -> None:
    text = CLOCKED + lite("s_axi_") + stream("s_axis_", "slave") + stream("m_axis_", "master")
    result = boundary([make("one", text), make("two", text)])
    assert result.ok
    assert [i.name for i in result.interfaces] == ["s_axi", "s_axis", "m_axis"]
    assert all(c.fit is Fit.CONNECT for a in result.adaptations for c in a.connections)
    assert result.interfaces[0].ports["AWADDR"] == "s_axi_awaddr"
    assert {(i.clock, i.reset, i.reset_polarity) for i in result.interfaces} == {("aclk", "aresetn", Polarity.LOW)}
    assert dict(result.interfaces[1].widths) == {"TDATA": 8, "TVALID": 1, "TREADY": 1}
    assert [(i.protocol, i.mode, i.vlnv, i.found_by) for i in result.interfaces[:2]] == [
        ("axi4lite", Mode.SLAVE, "xilinx.com:interface:aximm:1.0", FoundBy.NAME),
        ("axis", Mode.SLAVE, "xilinx.com:interface:axis:1.0", FoundBy.NAME),
    ]
    assert [(p.logical, p.direction.value, p.idle) for p in result.ports if p.interface == "m_axis"] == [
        ("TDATA", "out", 0), ("TVALID", "out", 0), ("TREADY", "in", 1),
    ]  # fmt: skip


def test_every_boundary_port_is_connected_once_and_every_module_port_too(make) -> None:
    first = make("one", CLOCKED + lite("s_axi_") + stream("s_axis_", "slave") + "output irq; output [3:0] leds")
    second = make("two", "input clk; input rst; " + stream("m_axis_", "master", extra="tlast:1"))
    result = boundary([first, second])
    for module, adaptation in zip([first, second], result.adaptations, strict=True):
        assert sorted(c.boundary for c in adaptation.connections if c.boundary) == sorted(p.name for p in result.ports)
        assert sorted(c.module for c in adaptation.connections if c.module) == sorted(p.name for p in module.ports)


def test_module_without_an_interface_has_its_outputs_tied_idle(make) -> None:
    full = make("full", CLOCKED + lite("s_axi_") + stream("s_axis_", "slave") + stream("m_axis_", "master"))
    bare = make("bare", CLOCKED + lite("s_axi_"))
    result = boundary([full, bare])
    adaptation = result.adaptation("bare")
    assert adaptation.ok
    assert (at(adaptation, "m_axis_tvalid").fit, at(adaptation, "m_axis_tvalid").value) == (Fit.TIE, 0)
    assert (at(adaptation, "s_axis_tready").fit, at(adaptation, "s_axis_tready").value) == (Fit.TIE, 1)
    assert at(adaptation, "s_axis_tdata").fit is Fit.OPEN
    assert adaptation.notes == (
        "has no s_axis: data sent there is dropped, so that the sender does not hang",
        "has no m_axis: it stays idle",
    )
    notes = boundary([bare, make("three", "input clk")]).adaptation("three").notes
    assert notes == ("has no s_axi: the generated wrapper answers accesses with an error, so that none hangs the bus",)


def test_only_interface_of_a_kind_is_paired_whatever_its_name(make) -> None:
    one = make("one", CLOCKED + stream("s_axis_", "slave"))
    two = make("two", CLOCKED + stream("video_in_", "slave"))
    result = boundary([one, two])
    assert [i.name for i in result.interfaces] == ["s_axis"]
    assert at(result.adaptation("two"), "s_axis_tdata").module == "video_in_tdata"
    assert "video_in is the region's s_axis: the only one of its kind" in result.adaptation("two").notes


def test_ambiguous_interfaces_are_not_paired_by_guess(make) -> None:
    one = make("one", CLOCKED + stream("a_", "slave") + stream("b_", "slave"))
    two = make("two", CLOCKED + stream("c_", "slave"))
    result = boundary([one, two])
    assert [i.name for i in result.interfaces] == ["a", "b", "c"]
    assert any("could be any of a, b" in note for note in result.adaptation("two").notes)


def test_data_of_another_width_is_refused_for_the_minority(make) -> None:
    modules = [
        make(name, CLOCKED + stream("s_axis_", "slave", width)) for name, width in (("a", 8), ("b", 32), ("c", 32))
    ]
    result = boundary(modules)
    assert widths(result)["s_axis_tdata"] == 32
    assert [a.ok for a in result.adaptations] == [False, True, True]
    assert "s_axis.TDATA has 8 bits, the region's s_axis 32" in result.adaptation("a").refused[0]
    others = [
        make(name, CLOCKED + stream("s_axis_", "slave", width)) for name, width in (("d", 8), ("e", 8), ("f", 32))
    ]
    assert widths(boundary(others))["s_axis_tdata"] == 8
    with pytest.raises(KeyError, match="none"):
        result.adaptation("none")


BOTH = stream("s_axis_", "slave") + stream("m_axis_", "master")
SHORT = lite("s_axi_").replace("[11:0]", "[5:0]")


@pytest.mark.parametrize(
    ("first", "second", "said"),
    [
        (CLOCKED + stream("m_", "master", extra="tlast:1"), CLOCKED + stream("m_", "master"), "m drives no TLAST"),
        (CLOCKED + lite("s_"), CLOCKED + lite("s_").partition("input [11:0] s_araddr")[0], "would hang the bus"),
        (
            CLOCKED + lite("s_axi_"),
            CLOCKED + lite("s_axi_") + "input [7:0] s_axi_awlen; input [7:0] s_axi_arlen",
            "s_axi is axi4 slave, but the s_axi of one is axi4lite slave",
        ),
        (BOTH + "input s_clk; input m_clk", BOTH + "input m_clk", "it needs a crossing"),
        (CLOCKED + BOTH, CLOCKED + BOTH.replace("input m_axis_tready; ", ""), "has no TREADY and cannot wait"),
        (CLOCKED, "input clk; inout sda", "sda is bidirectional"),
        (
            CLOCKED + stream("s_axis_", "slave"),
            CLOCKED + stream("s_axis_", "slave") + stream("S_AXIS_", "slave"),
            "S_AXIS and s_axis share a name",
        ),
        (CLOCKED, "input clk; input [3:0] s_axis_tdata; input [1:0] s_axis_tvalid", "side by side"),
    ],
)
def test_what_cannot_be_fitted_is_refused_with_the_reason(make, first: str, second: str, said: str) -> None:
    result = boundary([make("one", first), make("two", second)])
    assert result.adaptation("one").ok
    assert said in " ".join(result.adaptation("two").refused)


@pytest.mark.parametrize(
    ("first", "second", "port", "fit", "value"),
    [
        (lite("s_axi_"), SHORT, "s_axi_awaddr", Fit.TRUNCATE, 0),  # it sees fewer address bits
        (lite("m_axi_", "master"), lite("m_axi_", "master").replace("[11:0]", "[5:0]"), "m_axi_araddr", Fit.EXTEND, 0),
        (stream("s_", "slave"), stream("s_", "slave").replace("output s_tready; ", ""), "s_tready", Fit.TIE, 1),
        ("", "", "aresetn", Fit.CONNECT, 0),
    ],
)
def test_what_a_module_lacks_is_tied_or_cut(make, first: str, second: str, port: str, fit: Fit, value: int) -> None:
    result = boundary([make("one", CLOCKED + first), make("two", CLOCKED + second)])
    assert result.ok
    connection = at(result.adaptation("two"), port)
    assert (connection.fit, connection.value) == (fit, value)


@pytest.mark.parametrize("mode", ["slave", "master"])
def test_sideband_takes_the_widest_width(make, mode: str) -> None:
    narrow = make("narrow", CLOCKED + stream("s_", mode, extra="tuser:1 tid:2"))
    wide = make("wide", CLOCKED + stream("s_", mode, extra="tuser:4 tid:8"))
    result = boundary([narrow, wide])
    assert result.ok
    assert (widths(result)["s_tuser"], widths(result)["s_tid"]) == (4, 8)
    expected = Fit.TRUNCATE if mode == "slave" else Fit.EXTEND
    assert at(result.adaptation("narrow"), "s_tuser").fit is expected
    said = "are read, the rest is dropped" if mode == "slave" else "are driven, the rest is 0"
    assert set(result.adaptation("narrow").notes) == {f"s.TUSER: 1 of 4 bits {said}", f"s.TID: 2 of 8 bits {said}"}
    assert result.adaptation("wide").notes == ()


def test_missing_sideband_and_keep_are_tied_as_the_standard_says(make) -> None:
    full = make("full", CLOCKED + stream("m_", "master", 32, "tkeep:4 tstrb:4 tuser:2 tdest:3"))
    bare = make("bare", CLOCKED + stream("m_", "master", 32))
    adaptation = boundary([full, bare]).adaptation("bare")
    values = {name: at(adaptation, f"m_{name}").value for name in ("tkeep", "tstrb", "tuser", "tdest")}
    assert values == {"tkeep": 1, "tstrb": 1, "tuser": 0, "tdest": 0}


def _with_ids(mode: str, width: int) -> str:
    down, up = ("input", "output") if mode == "slave" else ("output", "input")
    ids = f"{down} [{width - 1}:0] x_awid; {down} [{width - 1}:0] x_arid; "
    return CLOCKED + lite("x_", mode) + ids + f"{up} [{width - 1}:0] x_bid; {up} [{width - 1}:0] x_rid; "


def test_slave_gives_back_every_bit_of_an_id(make) -> None:
    result = boundary([make("narrow", _with_ids("slave", 2)), make("wide", _with_ids("slave", 6))])
    assert result.ok
    assert widths(result)["x_awid"] == 2
    wide = result.adaptation("wide")
    assert wide.notes == ()
    assert (at(wide, "x_awid").fit, at(wide, "x_bid").fit) == (Fit.EXTEND, Fit.TRUNCATE)


def test_slave_without_ids_takes_them_from_the_boundary(make) -> None:
    result = boundary([make("with_ids", _with_ids("slave", 4)), make("without", CLOCKED + lite("x_"))])
    assert result.ok
    assert "x_awid" not in widths(result)
    loose = {c.module: c.fit for c in result.adaptation("with_ids").connections if not c.boundary}
    assert loose == {"x_awid": Fit.TIE, "x_bid": Fit.OPEN, "x_arid": Fit.TIE, "x_rid": Fit.OPEN}
    assert result.adaptation("with_ids").notes == tuple(
        f"x.{name} is 0: another module of the region has none" for name in ("AWID", "ARID")
    )


def test_masters_ids_are_as_wide_as_the_widest(make) -> None:
    result = boundary([make("narrow", _with_ids("master", 2)), make("none", CLOCKED + lite("x_", "master"))])
    assert result.ok
    assert widths(result)["x_awid"] == 2
    assert (at(result.adaptation("none"), "x_awid").fit, at(result.adaptation("none"), "x_awid").value) == (Fit.TIE, 0)


def test_master_without_write_channels_writes_nothing(make) -> None:
    text = lite("m_", "master")
    half = make("half", CLOCKED + text[text.index("output [11:0] m_araddr") :])
    result = boundary([make("whole", CLOCKED + text), half])
    assert result.ok
    values = {name: at(result.adaptation("half"), f"m_{name}").value for name in ("awvalid", "wvalid", "bready")}
    assert values == {"awvalid": 0, "wvalid": 0, "bready": 1}


def test_resets_of_both_polarities_share_one(make) -> None:
    result = boundary([make("low", "input clk; input rst_n"), make("high", "input clk; input rst; input reset")])
    assert [(p.name, p.role, p.idle) for p in result.ports] == [("aclk", Role.CLOCK, 0), ("aresetn", Role.RESET, 1)]
    assert [(c.module, c.fit) for c in result.adaptation("high").connections] == [
        ("clk", Fit.CONNECT),
        ("rst", Fit.INVERT),
        ("reset", Fit.INVERT),
    ]


def test_two_clocks_keep_their_names_and_their_resets(make) -> None:
    text = stream("s_axis_", "slave") + stream("m_axis_", "master")
    fifo = make("fifo", text + "input s_clk; input s_rst; input m_clk; input m_rst")
    result = boundary([fifo])
    assert result.ok
    assert [(i.clock, i.reset) for i in result.interfaces] == [("s_clk", "s_clk_resetn"), ("m_clk", "m_clk_resetn")]
    assert at(result.adaptation("fifo"), "m_clk_resetn").module == "m_rst"


def test_clocks_meet_by_name_where_a_module_has_several(make) -> None:
    modules = [
        make("one", "input z_clk; input z_rst"),
        make("two", "input s_clk; input m_clk"),
        make("three", "input M_CLK"),
    ]
    result = boundary(modules)
    assert [port.name for port in result.ports if port.role is Role.CLOCK] == ["s_clk", "m_clk", "z_clk"]
    assert {a.module: {c.boundary: c.module for c in a.connections if c.module} for a in result.adaptations} == {
        "one": {"z_clk": "z_clk", "z_clk_resetn": "z_rst"},
        "two": {"s_clk": "s_clk", "m_clk": "m_clk"},
        "three": {"m_clk": "M_CLK"},
    }
    assert result.ok


UNKNOWN = "the clock of s is not known: write clocks: {{{}: {{interfaces: [s]}}}} under the module, with the right one"


@pytest.mark.parametrize(
    ("declarations", "said"),
    [
        (stream("s_", "slave") + "input one_clk; input two_clk", UNKNOWN.format("one_clk")),
        (stream("s_", "slave"), UNKNOWN.format("CLOCK")),
        ('input clk; (* X_INTERFACE_INFO = "xilinx.com:signal:clock:1.0 pix CLK" *) output pix_clk',
         "pix_clk is a clock that the module drives: clocks do not cross a region's boundary outwards"),
        (_with_ids("slave", 2).replace("[1:0] x_awid", "[W-1:0] x_awid"), "the width of x.AWID could not be evaluated"),
        ("input rst", "the reset rst belongs to no clock: the region has none"),
    ],
)  # fmt: skip
def test_a_module_that_fits_no_boundary_says_why(make, declarations: str, said: str) -> None:
    assert said in boundary([make("one", declarations)]).adaptation("one").refused


def test_a_signal_called_as_a_port_of_a_bus_gets_another_name(make) -> None:
    one = make("one", CLOCKED + stream("s_axis_", "slave") + "output [3:0] _leds_; output aresetn_")
    two = make("two", "input clk; output [1:0] LEDS")
    result = boundary([one, two])
    assert {p.name: p.width for p in result.ports if p.role is Role.SIGNAL} == {"leds": 4, "aresetn_signal": 1}
    assert at(result.adaptation("two"), "leds").module == "LEDS"
    assert "LEDS: 2 of 4 bits are driven, the rest is 0" in result.adaptation("two").notes
    assert (at(result.adaptation("two"), "aresetn_signal").fit, result.ok) == (Fit.TIE, True)


def test_single_interrupts_share_a_line_and_several_keep_names(make) -> None:
    one = boundary([make("a", "input clk; output irq"), make("b", "input clk; output [1:0] done_interrupt")])
    assert widths(one)["interrupt"] == 2
    assert at(one.adaptation("a"), "interrupt").fit is Fit.EXTEND
    two = boundary([make("c", "input clk; output rx_irq; output tx_irq")])
    assert [p.name for p in two.ports if p.role is Role.INTERRUPT] == ["rx_irq", "tx_irq"]


def test_leftover_signals_are_shared_by_name_where_they_agree(make) -> None:
    one = make("one", "input clk; output [3:0] leds; input [1:0] mode; input [7:0] gain")
    two = make("two", "input clk; output [7:0] leds; output [1:0] mode; input [3:0] gain")
    result = boundary([one, two])
    assert widths(result)["leds"] == 8
    assert at(result.adaptation("one"), "leds").fit is Fit.EXTEND
    assert result.adaptation("two").refused == (
        "port mode is out, another module's mode is in",
        "port gain has 4 bits, another module's gain 8: give them different names",
    )


def test_user_protocol_meets_by_name_and_its_missing_signals_read_zero(make) -> None:
    text = "protocols: [{name: pix, signals: {d: out, v: out, err: {direction: out, required: false}}}]"
    options = {"protocols": parse_protocols(text)}
    one = make("one", "input clk; output [9:0] cam_d; output cam_v; output cam_err", **options)
    two = make("two", "input clk; output [9:0] cam_d; output cam_v", **options)
    result = boundary([one, two])
    assert result.ok
    assert result.interfaces[0].protocol == "pix"
    (bare,) = boundary([make("bare", "output [9:0] cam_d; output cam_v", **options)]).interfaces
    assert (bare.clock, bare.reset, bare.reset_polarity) == (None, None, None)
    assert (at(result.adaptation("two"), "cam_err").fit, at(result.adaptation("two"), "cam_err").value) == (Fit.TIE, 0)


def test_modules_of_one_top_are_told_apart_by_the_names_given(make) -> None:
    narrow = make("filter", CLOCKED + stream("m_", "master", extra="tuser:1"))
    wide = make("filter", CLOCKED + stream("m_", "master", extra="tuser:4"))
    result = making.boundary({"slow": narrow, "fast": wide})
    assert result.ok
    assert [(a.module, at(a, "m_tuser").fit) for a in result.adaptations] == [
        ("slow", Fit.EXTEND),
        ("fast", Fit.CONNECT),
    ]


def test_names_that_are_taken_are_numbered() -> None:
    assert [unique("a", taken) for taken in ([], ["a"], ["a", "a_2"], ["a_2"])] == ["a", "a_2", "a_3", "a"]
    assert [identifier(name) for name in ("S_AXIS", "_x.y_", "8b", "")] == ["s_axis", "x_y", "p_8b", "p_"]
