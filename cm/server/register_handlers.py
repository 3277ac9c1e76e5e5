# SPDX-License-Identifier: Apache-2.0
"""Handlers of requests for registers: a few at once, many piece by piece."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from cm.manager.access.register_service import AT_ONCE, ReadPieces, RegisterService, WritePieces
from cm.manager.manager import Manager
from cm.server.board_watch import BoardWatch
from cm.server.replies import Respond, refusal
from cm.server.shares import Client
from cm.server.steps import Steps
from cm.wire.bodies import encode_values, encoded_registers
from cm.wire.messages import requests as rq
from cm.wire.messages.status import RegValues, Reply


def takes_long(request: rq.ReadReg | rq.WriteReg, registers: RegisterService) -> bool:
    """Whether a request is for so many registers that it is done piece by piece."""
    named = request.writes if isinstance(request, rq.WriteReg) else request.names or registers.visible_names()
    return len(named) > AT_ONCE


class RegisterHandlers:
    """As `cm.server.handlers.Handlers`, which has them in its table."""

    def __init__(self, manager: Manager, steps: Steps, board: BoardWatch) -> None:
        self._manager = manager
        self._steps = steps
        self._board = board

    @property
    def table(self) -> Mapping[type, Callable[..., None]]:
        """The handler of each kind of request."""
        return {rq.ReadReg: self._read_reg, rq.WriteReg: self._write_reg}

    def _read_reg(self, request: rq.ReadReg, respond: Respond, client: Client) -> None:
        registers = self._manager.registers
        if takes_long(request, self._manager.registers):
            self._by_pieces(client, ReadPieces(registers, request.names), respond)
        else:
            respond(Reply(registers.read(request.names)))

    def _write_reg(self, request: rq.WriteReg, respond: Respond, client: Client) -> None:
        if takes_long(request, self._manager.registers):
            pieces = WritePieces(self._manager.registers, request.writes, request.lease)
            self._by_pieces(client, pieces, respond, self._manager.tell_registers)
        else:
            respond(Reply(self._manager.write_registers(request.writes, request.lease)))

    def _by_pieces(
        self,
        client: Client,
        work: ReadPieces | WritePieces,
        respond: Respond,
        then: Callable[[RegValues], object] = lambda _: None,
    ) -> None:
        """`then` gets what was done, even if that is not all."""

        encoded = _Encoded(work)

        def done(problem: Exception | None) -> None:
            result = encoded.result()
            if result.values:
                then(result)
            if problem is not None:
                self._board.noticed(problem)
            respond(Reply(result) if problem is None else refusal(problem))

        self._steps.start(client, encoded, done)


class _Encoded:
    """A job whose values are encoded as they come: encoding all at once would take longer than any piece."""

    def __init__(self, work: ReadPieces | WritePieces) -> None:
        self._work = work
        self._parts: list[bytes] = []

    def step(self) -> bool:
        """As the work's."""
        ended = self._work.step()
        self._parts.append(encode_values(self._work.newest))
        return ended

    def result(self) -> RegValues:
        """What was done."""
        return encoded_registers(self._work.result, self._parts)
