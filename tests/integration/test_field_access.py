# SPDX-License-Identifier: Apache-2.0
"""Fields that are not simply read and written, and modes that start what they hold (`run:`)."""

from __future__ import annotations

from collections.abc import Iterator
from operator import setitem as put
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from manager_process import Manager

import cm
from cm.client.errors import RequestFailed
from cm.client.register_window import RegisterWindow
from cm.errors import CmError
from cm.schema import SchemaError, dump, loads

SCHEMA = """
config:
  name: kernels
  modules:
    default:
      mmio:
        - base_address: 0x43c00000
          registers:
            control:
              offset: 0x0
              volatile: true
              fields:
                start: {lsb: 0, access: w1s}
                done: {lsb: 1, access: rc}
                key: {lsb: 4, width: 3, access: wo}
                auto_restart: {lsb: 7}
            status: {offset: 0x4, volatile: true, fields: {one: {lsb: 0, access: w1t}, level: {lsb: 8, width: 4}}}
            gain: {offset: 0x10, default: 3}
            level: {offset: 0x14, min: 5, max: 100, doc: How loud.}
            wide: {offset: 0x18, width: 64, fields: {high: {lsb: 40, width: 8, values: {off: 0, full: 255}}}}
            ident: {offset: 0x20, access: ro}
            key: {offset: 0x24, access: wo, fields: {low: {lsb: 4, width: 4}, hint: {lsb: 8, access: w1s}}}
            flags: {offset: 0x28, access: w1c, fields: {first: {lsb: 0}, second: {lsb: 1}}}
            small: {offset: 0x2c, width: 16}
            array: {offset: 0x30}
            with-dash: {offset: 0x34}
          memories:
            taps: {offset: 0x800, size: 16, dtype: int16, shape: [2, 4]}
            log: {offset: 0x840, size: 8, access: ro}
            sink: {offset: 0x848, size: 8, access: wo}
  modes:
    idle: {modules: [default]}
    always: {modules: [default], run: continuous}
    once: {modules: [default], run: once}
"""


@pytest.fixture(scope="module")
def board(tmp_path_factory: pytest.TempPathFactory) -> Iterator[cm.Board]:
    folder = tmp_path_factory.mktemp("kernels")
    (folder / "kernels.yaml").write_text(SCHEMA)
    manager = Manager(folder / "run", "--sim", "--config", str(folder)).start()
    try:
        with manager.connected() as connected:
            connected.load("kernels", mode="idle")
            yield connected
    finally:
        manager.stop()


def test_a_write_of_one_field_leaves_those_alone_that_a_written_1_changes(board: cm.Board) -> None:
    board.registers["status"] = 0x301
    board.registers["status.level"] = 5
    assert board.registers["status"] == 0x500, "0 to `one`, whatever it reads"
    board.registers["control"] = 0xD1
    board.registers["control.auto_restart"] = 0
    assert board.registers["control"] == 0x50, "what was written last, for nothing was read; `start` is not kept"


@pytest.fixture(scope="module")
def regs(board: cm.Board) -> Iterator[RegisterWindow]:
    with board.registers.window("default") as window:
        yield window


@pytest.fixture(scope="module")
def seen(board: cm.Board) -> Iterator[RegisterWindow]:
    """A window for reading."""
    with board.registers.window("default", write=False) as window:
        yield window


def test_a_window_leaves_them_alone_too(board: cm.Board) -> None:
    with board.registers.window("default") as regs:
        regs.status = 0x301
        regs["status.level"] = 5
        assert regs.status == 0x500
        for name, why in (("control.auto_restart", "has a field that reading clears"), ("key.low", "is write-only")):
            with pytest.raises(RequestFailed) as refused:
                regs[name] = 1
            name = name.partition(".")[0]
            assert str(refused.value) == f"register {name!r} {why}: write the whole of it here first"
            assert refused.value.code == "access"
        regs.control = 0xD1
        regs["control.auto_restart"] = 0
        assert (regs.control, regs["control.key"]) == (0x50, 5)
        regs.key = 0xFFF
        regs["key.low"] = 3


def test_a_window_has_what_its_module_has(regs: Any, seen: Any, board: cm.Board) -> None:
    assert set(regs) == {r.name for r in board.config().registers}
    assert (len(regs), regs.region, regs.module, regs.revoked) == (len(set(regs)), "prr0", "default", False)
    assert (repr(regs), type(regs).level.__doc__, type(regs).gain.__doc__) == ("<window of default>", "How loud.", None)
    regs["array"], regs["with-dash"] = 6, 7  # names that an attribute cannot have
    assert (regs["array"], seen["with-dash"], regs.array("array", 2).tolist()) == (6, 7, [6, 7])
    with pytest.raises(AttributeError):
        regs.nope = 1
    closed = board.registers.window("default")
    closed.close()
    assert (repr(closed), closed.revoked) == ("<window of default, closed>", True)


@pytest.mark.parametrize(
    ("name", "value", "holds"),
    [
        ("level", 5, 5),
        ("level", 100, 100),
        ("gain", 0, 0),
        ("gain", (1 << 32) - 1, (1 << 32) - 1),
        ("small", 0xFFFF, 0xFFFF),
        ("wide", (1 << 64) - 1, (1 << 64) - 1),
        ("wide", 1 << 40, 1 << 40),
        ("wide.high", 255, 255),
        ("wide.high", "off", 0),
        ("wide.high", "full", 255),
        ("status.level", 0, 0),
        ("status.level", np.uint8(15), 15),
    ],
)
def test_a_window_holds_what_the_schema_allows(regs: Any, board: cm.Board, name: str, value: Any, holds: int) -> None:
    regs[name] = value
    assert regs[name] == board.registers[name] == holds


NAMES = (
    "control, control.start, control.done, control.key, control.auto_restart, status, status.one, status.level, gain, "
    "level, wide, wide.high, ident, key, key.low, key.hint, flags, flags.first, flags.second, small, array, with-dash"
)
NONE = f"no register 'nope' in this window; there are {NAMES}"
OUTSIDE = "is outside 0 to 4294967295 (0x0 to 0xffffffff)"


REFUSED = {
    "out_of_range": [
        (lambda w: put(w, "level", 4), "register 'level': 4 (0x4) is outside 5 to 100 (0x5 to 0x64)"),
        (lambda w: put(w, "level", 101), "register 'level': 101 (0x65) is outside 5 to 100 (0x5 to 0x64)"),
        (lambda w: put(w, "gain", 1 << 32), f"register 'gain': 4294967296 (0x100000000) {OUTSIDE}"),
        (lambda w: put(w, "gain", -1), f"register 'gain': -1 (-0x1) {OUTSIDE}"),
        (lambda w: put(w, "small", 1 << 16), "register 'small': 65536 (0x10000) is outside 0 to 65535 (0x0 to 0xffff)"),
        (lambda w: put(w, "wide.high", 256), "register 'wide.high': 256 (0x100) is outside 0 to 255 (0x0 to 0xff)"),
        (lambda w: put(w, "wide.high", -1), "register 'wide.high': -1 (-0x1) is outside 0 to 255 (0x0 to 0xff)"),
        (lambda w: put(w, "wide.high", "ful"), "'wide.high' has no value 'ful'; there are off, full"),
        (lambda w: put(w, "status.level", "on"), "'status.level' has no value 'on'; there are none"),
        (lambda w: w.put_array("gain", [1, 4]), "register 'gain+1': 4 (0x4) is outside 5 to 100 (0x5 to 0x64)"),
        (lambda w: w.put_array("gain", [1, 101]), "register 'gain+1': 101 (0x65) is outside 5 to 100 (0x5 to 0x64)"),
        (lambda w: w.put_array("gain", [-1, 50]), f"register 'gain+0': -1 (-0x1) {OUTSIDE}"),
        (lambda w: w.put_array("gain", [1 << 32, 50]), f"register 'gain+0': 4294967296 (0x100000000) {OUTSIDE}"),
    ],
    "access": [
        (lambda w: put(w, "control.done", 1), "'control.done' is read-only"),
        (lambda w: put(w, "ident", 1), "'ident' is read-only"),
        (lambda w: w["key"], "'key' is write-only"),
        (lambda w: w.array("ident", 2), "'key' is write-only"),
        (lambda w: w.array("sink"), "'sink' is write-only"),
        (lambda w: w.put_array("ident", [1]), "'ident' is read-only"),
        (lambda w: w.put_array("log", [1, 2]), "'log' is read-only"),
    ],
    "unknown_register": [
        (lambda w: w["nope"], NONE),
        (lambda w: put(w, "nope", 1), NONE),
        (lambda w: w.array("nope"), NONE),
    ],
    "invalid_request": [
        (lambda w: w.array("gain", 3), "3 registers of 32 bits from 'gain' on: 2 of them are there"),
        (lambda w: w.array("gain", 0), "0 registers of 32 bits from 'gain' on: 0 of them are there"),
        (lambda w: w.array("wide"), "1 registers of 32 bits from 'wide' on: 0 of them are there"),
        (lambda w: w.put_array("gain", [1.5]), "registers from 'gain' on take integers, not float64"),
        (lambda w: w.put_array("taps", [1, 2]), "memory 'taps' has 16 bytes; these are 4"),
    ],
}  # fmt: skip


@pytest.mark.parametrize(
    ("code", "use", "says"), [(code, use, says) for code, rows in REFUSED.items() for use, says in rows]
)
def test_a_window_refuses_what_the_schema_forbids_in_words(regs: Any, code: str, use: Any, says: str) -> None:
    with pytest.raises(CmError) as refused:
        use(regs)
    assert (refused.value.code, str(refused.value)) == (code, says)


def test_a_window_for_reading_writes_nothing(seen: Any, board: cm.Board) -> None:
    for use in (
        lambda: put(seen, "gain", 9),
        lambda: seen.put_array("gain", [9]),
        lambda: put(seen, "wide.high", 1),
    ):
        before = board.registers.read()
        with pytest.raises(RequestFailed, match=r"^the window of default is for reading$") as refused:
            use()
        assert (refused.value.code, board.registers.read()) == ("access", before)
    with pytest.raises(RequestFailed, match=r"^'ident' is read-only$"):
        seen["ident"] = 1


def test_registers_in_a_row_and_memories_are_arrays_of_a_window(regs: Any, board: cm.Board) -> None:
    regs.put_array("gain", [[(1 << 32) - 1, 100]])
    found = regs.array("gain", 2)
    assert (found.tolist(), found.dtype) == ([(1 << 32) - 1, 100], np.uint32)
    regs.put_array("gain", np.array([True]))
    regs.put_array("level", 5)
    assert (regs.array("gain").tolist(), regs.array("level").tolist()) == ([1], [5])
    taps = np.arange(8).reshape(2, 4) - 5
    regs.put_array("taps", taps)
    found = regs.array("taps")
    assert (found.tolist(), found.dtype, board.memories["taps"].read().tolist()) == (
        taps.tolist(),
        "<i2",
        taps.tolist(),
    )
    regs.put_array("sink", [1, 2])
    assert regs.array("log").tolist() == [0, 0]


def test_what_cannot_be_read_or_written_is_refused_by_its_name(board: cm.Board) -> None:
    with pytest.raises(RequestFailed, match=r"field 'control\.done' is read-only"):
        board.registers["control.done"] = 1
    with pytest.raises(RequestFailed, match=r"field control\.key is write-only"):
        board.registers["control.key"]


def test_reading_everything_leaves_out_what_reading_clears(board: cm.Board) -> None:
    everything = board.registers.read()
    assert "gain" in everything
    assert "control" not in everything


def test_clients_see_the_access_of_a_field(board: cm.Board) -> None:
    (control,) = (r for r in board.config().registers if r.name == "control")
    assert {f.name: f.access for f in control.fields} == {"start": "w1s", "done": "rc", "key": "wo", "auto_restart": ""}


def test_a_mode_starts_what_it_holds_when_its_registers_are_set(board: cm.Board) -> None:
    board.set_mode("always")
    assert board.registers["control"] == 0x81
    steps = [step.subject for step in board.plan("once").steps if step.kind == "registers"]
    assert steps[-1:] == ["control"]
    board.set_mode("once")
    assert board.registers["control"] == 0x01
    board.registers["control"] = 0
    board.set_mode("idle")
    board.set_mode("once")
    assert board.registers["control"] == 0x01, "each time that it is entered"


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("start:", "begin:", "no module of this mode has a register that starts it"),
        ("offset: 0x0", "offset: 0x0, default: 1", "control has a default too"),
        ("volatile: true\n", "access: ro\n", "a field of other access in a register of ro"),
    ],
)
def test_what_cannot_be_is_refused(old: str, new: str, said: str) -> None:
    text = SCHEMA.replace(old, new, 1).replace("offset: 0x0, default: 1\n", "offset: 0x0\n              default: 1\n")
    with pytest.raises(SchemaError, match=said):
        loads(text)


def test_the_normal_form_has_both(tmp_path: Path) -> None:
    config = loads(dump(loads(SCHEMA)))
    assert config.modes["once"].run == "once"
    assert config.modules["default"].registers["control"].fields["done"].access == "rc"
