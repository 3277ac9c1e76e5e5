# SPDX-License-Identifier: Apache-2.0
"""Requests from the other side of a bridge, made in the caller's name."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import replace

from cm.bridge.frames import FrameWriter
from cm.bridge.records import Caller
from cm.client.board import Board
from cm.client.core import calls
from cm.client.core.values import register_write
from cm.messages.requests import WriteReg
from cm.messages.status import ConfigEntry, ConfigInfo, PlanInfo, Progress, RegValues, Status

_KEPT = 16  # connections of guests that are kept open

Connect = Callable[[str], Board]
"""Makes a connection in the name of a guest; of the bridge's own where the name is empty."""


class Commands:
    """Requests of callers; threads may share it. Every call raises CmError with what was refused, and why."""

    def __init__(self, connect: Connect) -> None:
        self._connect = connect
        self._boards: OrderedDict[str, Board] = OrderedDict()
        self._lock = threading.Lock()

    def board(self, caller: Caller) -> Board:
        """The connection for a caller's short requests, which remains ours to close."""
        with self._lock:
            board = self._boards.pop(caller.guest, None) or self._connect(caller.guest)
            self._boards[caller.guest] = board
            oldest = self._boards.popitem(last=False)[1] if len(self._boards) > _KEPT else None
        if oldest is not None:
            oldest.close()
        return board

    def status(self, caller: Caller) -> Status:
        """The status now."""
        return self.board(caller).status

    def configs(self, caller: Caller) -> tuple[ConfigEntry, ...]:
        """All configurations that can be loaded, with their modes."""
        return self.board(caller).config_entries()

    def config(self, caller: Caller, name: str = "") -> ConfigInfo:
        """A configuration; the loaded one's if no name is given."""
        return self.board(caller).config(name)

    def plan(self, caller: Caller, config: str = "", mode: str = "") -> PlanInfo:
        """What going to a mode would do; touches nothing."""
        return self.board(caller).plan(mode, config)

    def change(
        self,
        caller: Caller,
        config: str = "",
        mode: str = "",
        *,
        queue: bool = True,
        force: bool = False,
        progress: Callable[[Progress], None] | None = None,
        timeout: float | None = None,
    ) -> float:
        """Go to a mode and wait; returns the seconds it took.

        It uses a connection of its own, so that others are answered meanwhile.
        """
        with self._connect(caller.guest) as board:
            return board.load(
                config, mode, progress=progress or False, timeout=timeout, queue=queue, force=force, lease=caller.lease
            )

    def cancel(self, caller: Caller) -> None:
        """Cancel the change that runs."""
        self.board(caller).cancel()

    def read_registers(self, caller: Caller, *names: str) -> RegValues:
        """Registers or fields by name; all that can be read if none is named."""
        return self.board(caller).ask(calls.read_registers(names))

    def write_registers(
        self, caller: Caller, values: Mapping[str, int | str], masks: Mapping[str, int] | None = None
    ) -> RegValues:
        """Several registers or fields in order, all checked before the first is written.

        `masks`: for a register named there, only these bits are written.
        """
        writes = [register_write(name, value) for name, value in values.items()]
        masked = [
            replace(write, mask=masks[write.name]) if masks and write.name in masks else write for write in writes
        ]
        call = calls.write_registers({}, caller.lease)
        return self.board(caller).ask(replace(call, request=WriteReg(tuple(masked), caller.lease)))

    def writer(self, caller: Caller, stream: str) -> FrameWriter:
        """Frames towards the hardware; the caller closes it."""
        return FrameWriter(self.board(caller), stream, caller.lease)

    def close(self) -> None:
        """Disconnect; twice is fine."""
        with self._lock:
            boards, self._boards = list(self._boards.values()), OrderedDict()
        for board in boards:
            board.close()
