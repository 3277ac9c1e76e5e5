# SPDX-License-Identifier: Apache-2.0
"""Run in the simulator: PYNQ's own driver of an AXI DMA without scatter/gather (pynq/lib/dma.py) on the engine.

Its class is taken from its file as it is; registers are those of the simulated engine, buffers lie in the memory.
"""

from __future__ import annotations

import ast
import os
from pathlib import Path
from typing import Any

import cocotb
from cocotb.task import bridge, resume
from cocotb_axi_dma import Bench, bench, check_bursts, clean
from cocotbext.axi import AxiStreamFrame

CHANNEL = "_SDMAChannel"


def driver(path: Path) -> Any:
    """The class, with the constants of its module."""
    wanted = [
        node
        for node in ast.parse(path.read_text()).body
        if isinstance(node, ast.Assign) or (isinstance(node, ast.ClassDef) and node.name == CHANNEL)
    ]
    names: dict[str, Any] = {}
    exec(compile(ast.Module(wanted, []), str(path), "exec"), names)
    return names[CHANNEL]


class Registers:
    """What PYNQ calls MMIO."""

    def __init__(self, rig: Bench) -> None:
        self.read = resume(rig.read)
        self.write = resume(rig.write)


class Buffer:
    """What PYNQ calls a contiguous array."""

    def __init__(self, address: int, length: int) -> None:
        self.physical_address, self.nbytes, self.calls = address, length, []

    def flush(self) -> None:
        self.calls.append("flush")

    def invalidate(self) -> None:
        self.calls.append("invalidate")


@cocotb.test()
async def pynqs_driver_sends_and_receives(dut: object) -> None:
    rig = await bench(dut, 11)
    channel, registers = driver(Path(os.environ["CM_PYNQ"]) / "pynq/lib/dma.py"), Registers(rig)
    beat = rig.beat

    @bridge
    def start() -> tuple[Any, Any]:
        return channel(registers, (1 << 23) - 1, beat[0], 1, False), channel(
            registers, (1 << 23) - 1, beat[48], 0, False
        )

    @bridge
    def transfer(one: Any, buffer: Buffer, length: int) -> None:
        one.transfer(buffer, nbytes=length)

    @bridge
    def wait(one: Any) -> int:
        one.wait()
        return int(one.transferred)

    sending, receiving = await start()
    for length in (64, 1000, 3, 256, 777):
        source, target = Buffer(rig.place(0, length), length), Buffer(rig.place(48, 2000), 2000)
        await transfer(sending, source, length)
        assert await wait(sending) == length
        assert bytes((await rig.sink.recv()).tdata) == rig.memory.read(source.physical_address, length)
        assert source.calls == ["flush"]
        data = rig.chance.randbytes(length)
        await transfer(receiving, target, 2000)
        await rig.source.send(AxiStreamFrame(data))
        assert await wait(receiving) == length  # shorter than its buffer
        assert rig.memory.read(target.physical_address, length) == data
        assert target.calls == ["invalidate"]

    dut.bad_write.value = 3
    await transfer(receiving, Buffer(rig.place(48, 64), 64), 64)
    await rig.source.send(AxiStreamFrame(bytes(64)))
    told = ""
    try:
        await wait(receiving)
    except RuntimeError as error:
        told = str(error)
    assert told.startswith("DMA"), told
    dut.bad_write.value = 0
    await clean(rig)

    @bridge
    def again() -> bool:
        for one in (sending, receiving):
            one.start()
            one.stop()
            one.start()
        return bool(sending.running and receiving.running and not sending.error)

    assert await again()
    check_bursts(rig.checker)
