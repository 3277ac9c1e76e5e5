# SPDX-License-Identifier: Apache-2.0
"""What people do from a laptop, with a board elsewhere: ``laptop.py SYSTEM laptop_client.py ADDRESS FOLDER``."""

from __future__ import annotations

import asyncio
import os
import sys
from collections.abc import Callable
from importlib import import_module

import cm
import cm.aio
from cm.cli.main import main
from cm.errors import InvalidRequest


def by_hand(address: str) -> None:
    """The blocking client."""
    with cm.connect(address, timeout=30) as board:
        assert board.load("camera", "default", progress=lambda _: None) >= 0
        board.mode = "edge_detection"
        board.registers["focus"] = 2
        assert board.registers["focus"] == 2
        with board.stream("camera", timeout=60) as frames:
            assert frames.read().shape == (480, 640)
        with board.stream("camera", timeout=60, newest=True) as frames:
            assert frames.read().shape == (480, 640)
        with board.lease("region:prr0"), board.watch() as statuses:
            assert statuses.next(60).mode == "edge_detection"
        board.memories["scratchpad"].write([1, 2, 3])
        assert board.plan("default").bytes > 0
        assert dir(board.registers)
        assert board.interrupts.names
        assert "only its own machine has" in error_of(lambda: board.writer("to_pl", timeout=60))
        assert "only its own machine has" in error_of(lambda: board.allocate(4))
    assert "connect('tcp://kria.local')" in error_of(cm.connect)
    assert "on Linux only" in error_of(lambda: import_module("cm.device"))


def error_of(call: Callable[[], object]) -> str:
    """What it raises, as a sentence; empty if it does not."""
    try:
        call()
    except (InvalidRequest, ImportError) as error:
        return str(error)
    return ""


async def awaited(address: str) -> None:
    """The asyncio client."""
    async with cm.aio.connect(address, timeout=30) as board:
        await board.set_mode("default")
        async with board.stream("camera", timeout=60) as frames:
            assert (await frames.read()).shape == (480, 640)
        assert (await board.registers.read("focus"))["focus"] == 1


def commands(address: str) -> None:
    """The command line."""
    for line in ("status", "configs", "plan edge_detection", "mode edge_detection", "reg list", "reg read focus",
                 "reg write focus=3", "mem list", "irq list", "stream list", "watch --count 1", "cancel"):  # fmt: skip
        assert main([*line.split(), "--connect", address]) == 0, line
    os.environ["CM_CONNECT"] = address
    assert main(["status"]) == 0
    assert cm.connect(timeout=60).mode == "edge_detection"
    assert main(["keygen", "keys", "laptop"]) == 0
    for line in ("serve", "sim", "doctor", "demo"):
        assert main([line]) == 1


assert cm.__file__.startswith(sys.argv[2]), "the package that was installed, and no work tree"
by_hand(sys.argv[1])
asyncio.run(awaited(sys.argv[1]))
commands(sys.argv[1])
print("all of it works")
