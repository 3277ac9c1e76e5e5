# SPDX-License-Identifier: Apache-2.0
"""The cost of a register write does not depend on the number of registers."""

from __future__ import annotations

import time
from typing import Any

from cm.manager.access.leases import Leases
from cm.manager.access.register_bus import RegisterBus
from cm.manager.access.register_service import RegisterService
from cm.manager.inputs import Window
from cm.manager.state.board_state import BoardState
from cm.manager.state.journal import ManagerState
from cm.schema import loads
from cm.wire.messages.requests import RegWrite

FEW, MANY = 10, 1000
ROUNDS, WRITES = 40, 50
TEXT = """
config:
  name: many
  modes: {{only: {{}}}}
  mmio:
    - base_address: 0x1000
      registers: {{{registers}}}
"""


class Memory:
    """A device of registers that are memory."""

    def __init__(self) -> None:
        self.cells: dict[int, int] = {}

    def window(self, address: int, width: int) -> Window:
        device: Any = self
        return Window(device, 0, address)

    def read(self, offset: int, width: int = 32, number: int = 0) -> int:
        return self.cells.get(offset, 0)

    def write(self, offset: int, value: int, width: int = 32, number: int = 0) -> None:
        self.cells[offset] = value


def service(count: int) -> tuple[RegisterService, ManagerState]:
    """The register service of a configuration with `count` registers, all of them written."""
    registers = ", ".join(f"r{number}: {{offset: {4 * number}}}" for number in range(count))
    journal: Any = None
    state = ManagerState({"many": loads(TEXT.format(registers=registers))}, journal)
    state.update(lambda _: BoardState("many", "only"))
    devices: Any = Memory()
    made = RegisterService(state, RegisterBus(devices), Leases(time))
    made.write(tuple(RegWrite(f"r{number}", number) for number in range(count)), "")
    return made, state


def seconds(made: RegisterService) -> float:
    """Processor time of a batch of writes."""
    writes = [(RegWrite(f"r{number % FEW}", number),) for number in range(WRITES)]
    begin = time.thread_time()
    for write in writes:
        made.write(write, "")
    return time.thread_time() - begin


def test_a_write_costs_the_same_with_ten_and_with_a_thousand_registers() -> None:
    """Batches alternate, and the fastest of each is used, because other load slows both."""
    few, many = service(FEW)[0], service(MANY)[0]
    best = {"few": float("inf"), "many": float("inf")}
    for _ in range(ROUNDS):
        best["few"] = min(best["few"], seconds(few))
        best["many"] = min(best["many"], seconds(many))
    assert best["many"] < 2 * best["few"], best


def test_a_written_value_is_in_the_state_that_is_recorded_and_in_no_copy_before_that() -> None:
    made, state = service(FEW)
    before = state.latest
    made.write((RegWrite("r3", 77),), "")
    assert state.latest is before, "a write replaces nothing"
    assert state.written_value("r3") == 77
    assert state.board.values["r3"] == 77
    assert state.board is state.latest
