# SPDX-License-Identifier: Apache-2.0
"""Fields that are not simply read and written, and modes that start what they hold (`run:`)."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from manager_process import Manager

import cm
from cm.client.errors import RequestFailed
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


def test_a_window_leaves_them_alone_too(board: cm.Board) -> None:
    with board.registers.window("default") as regs:
        regs.status = 0x301
        regs["status.level"] = 5
        assert regs.status == 0x500
        with pytest.raises(RequestFailed, match="has a field that reading clears: write the whole of it here first"):
            regs["control.auto_restart"] = 1
        regs.control = 0xD1
        regs["control.auto_restart"] = 0
        assert regs.control == 0x50
        with pytest.raises(RequestFailed, match="read-only"):
            regs["control.done"] = 1


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
