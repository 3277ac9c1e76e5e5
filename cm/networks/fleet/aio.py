# SPDX-License-Identifier: Apache-2.0
"""The asyncio client of a fleet; `cm.networks.fleet.connect` is the blocking one, with the same names."""

from __future__ import annotations

import asyncio
import getpass
import os
import secrets
from collections.abc import Generator, Iterable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

from cm.client.core.calls import write_data, write_registers
from cm.client.errors import request_error
from cm.client.frame import Frame, frame_of
from cm.errors import InvalidRequest
from cm.networks.fleet import answers, asking, bundles, names
from cm.networks.fleet.asking import Answer, absent
from cm.networks.fleet.change.asks import Ask, Verb
from cm.networks.fleet.change.coordinator import Outcome, first_step
from cm.networks.fleet.changing import Course, Progress, carried_out, nothing
from cm.networks.fleet.errors import ChangeFailed, FleetRefused
from cm.networks.fleet.looking import ALL, Looker
from cm.networks.fleet.network import Network, from_environment, member_of, session
from cm.networks.fleet.presence import Presence
from cm.networks.fleet.recovering import open_changes, recovered, refuse_other, useful_seats
from cm.wire import fleet as wire
from cm.wire import fleet_records as records
from cm.wire import topics
from cm.wire.encode import decode_event, decode_reply, encode_request
from cm.wire.messages.fleet import BundleState, FleetRecord, FleetStep, Policy
from cm.wire.messages.status import ErrorInfo, FrameInfo, RegValues


def connect(
    router: str | Iterable[str] = (),
    *,
    config: str | os.PathLike[str] | None = None,
    caller: str = "",
    timeout: float = 10.0,
) -> Fleet:
    """A fleet, to be entered with ``async with``, or awaited.

    `router`: zenoh's ``tcp/host:port`` or ``tls/host:port`` (default: `$CM_FLEET`, or else whoever is found on this
    network). `config`: a file of zenoh's settings, as ``cm fleet keys`` writes them. `caller`: the name to make
    requests under; with certificates, the one in your own. `timeout` in seconds. Raises NoNetwork when it is entered.
    """
    routers = (router,) if isinstance(router, str) else tuple(router)
    if not routers and config is None:
        routers = from_environment()
    network = Network(connect=routers, config=Path(config) if config else None)
    return Fleet(network, caller or member_of(network.config) or getpass.getuser(), timeout)


class Fleet(Looker):
    """Many boards. Groups of them are given by name, glob (``line1-*``) or label (``@camera``); by default all."""

    def __init__(self, network: Network, caller: str, timeout: float) -> None:
        self.caller = names.check(caller, "caller")
        self.timeout = timeout
        self._network = network
        self.session: Any = None

    async def __aenter__(self) -> Fleet:
        self.session = await asyncio.to_thread(session, self._network)
        self._presence = Presence(self.session)
        try:
            await self._presence.begin(self.timeout)
        except BaseException:
            await self.close()
            raise
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None
    ) -> None:
        await self.close()

    def __await__(self) -> Generator[Any, None, Fleet]:
        return self.__aenter__().__await__()

    async def close(self) -> None:
        """Disconnect; twice is fine."""
        if self.session is not None:
            await asyncio.to_thread(self.session.close)

    # ---- changing -------------------------------------------------------------------------------

    async def do(
        self, verb: str, board: str, message: bytes, data: bytes | None = None, timeout: float = 0.0
    ) -> Answer:
        """A command for one board, in this caller's name: `message` is serialised, `data` is the payload beside it.

        The answer's payload is a Reply; it has an error if none came within `timeout` seconds (0: the fleet's).
        """
        key = names.command_key(names.check(board, "board"), verb, self.caller)
        payload, attachment = (message, None) if data is None else (data, message)
        found = await asking.get(self.session, key, payload, attachment, timeout or self.timeout)
        return found[0] if found else Answer(board, key, b"", error=absent(board in await self.boards()))

    async def write(
        self, values: Mapping[str, int | str], boards: Iterable[str] = ALL
    ) -> dict[str, RegValues | ErrorInfo]:
        """Write registers on each board, in order; each board does all of it or nothing, and answers for itself.

        Raises NoSuchBoard.
        """
        message = bytes(encode_request(write_registers(values).request)[1])
        chosen = await self.chosen(boards)
        said = await asyncio.gather(*(self.do("reg", name, message) for name in chosen))
        return {n: answers.registers(a) for n, a in zip(chosen, said, strict=True)}

    async def frame(self, board: str, stream: str) -> Frame:
        """The next frame of a stream of one board, as an array of the stream's shape. Raises RequestFailed."""
        found = await asking.get(self.session, names.key(board, "frames", stream), timeout=self.timeout)
        answer = found[0] if found else Answer(board, "", b"", error=absent(board in await self.boards()))
        if answer.error is not None:
            raise request_error(answers.named(board, answer.error))
        info = decode_event([topics.READ_DATA, answer.attachment])
        if not isinstance(info, FrameInfo):
            raise InvalidRequest(f"{board}: no frame came back")
        return frame_of(info, answer.payload)

    async def send(self, board: str, stream: str, data: Any) -> None:
        """An array or bytes for a stream of one board; returns when the hardware has taken it. Raises RequestFailed."""
        frames = encode_request(write_data(stream, data, "").request)
        answer = await self.do("data", board, bytes(frames[1]), bytes(frames[2]))
        error = answer.error or decode_reply([b"", answer.payload]).error
        if error is not None:
            raise request_error(answers.named(board, error))

    async def load(
        self,
        config: str = "",
        mode: str = "",
        boards: Iterable[str] = ALL,
        *,
        policy: Policy | str = Policy.ALL,
        timeout: float = 60.0,
        settle: float = 0.0,
        tell: Progress = nothing,
    ) -> Course:
        """Take all boards to a mode, or none: plan on all, prepare all, change all, then keep the new mode or go back.

        `policy`: ``all``, ``quorum`` or ``best-effort``: how many boards must succeed for the change to be kept.
        `timeout`: seconds for each phase. `settle`: seconds after which a board that hears nothing asks what was
        decided (0: twice `timeout`). `tell` is called with the phase, a board, and its answer. Returns the outcome with
        the critical path. Raises NoSuchBoard, FleetRefused (nothing was touched), ChangeFailed (its outcome names each
        board that differs). If this is cancelled or killed at any moment, the boards end the change by themselves;
        `recover` hastens that.
        """
        rule = records.policy(policy)
        chosen = await self.chosen(boards)
        plans = await self.plan(mode, config, chosen)
        problems = {name: plan for name, plan in plans.items() if isinstance(plan, ErrorInfo)}
        able = [name for name in chosen if name not in problems]
        if not rule.holds(len(chosen), len(able)):
            raise FleetRefused(problems)
        change = f"{self.caller}-{secrets.token_hex(4)}"
        where = await useful_seats(able, await self.boards(), self._ask, change)
        step = first_step(change, chosen, config, mode, rule, settle or 2 * timeout, where)
        course = await carried_out(step, lambda ask: self._step(ask, timeout), tell)
        if course.outcome.differing or course.outcome.decision is None or course.outcome.decision.value != "keep":
            raise ChangeFailed(course.outcome)
        return course

    async def mode(
        self,
        mode: str,
        boards: Iterable[str] = ALL,
        *,
        policy: Policy | str = Policy.ALL,
        timeout: float = 60.0,
        settle: float = 0.0,
        tell: Progress = nothing,
    ) -> Course:
        """Take all boards to a mode of what they have loaded, or none; as `load`."""
        return await self.load("", mode, boards, policy=policy, timeout=timeout, settle=settle, tell=tell)

    async def _step(self, ask: Ask, timeout: float) -> FleetRecord | ErrorInfo:
        answer = await self.do(ask.verb.value, ask.board, records.encode_step(ask.step), timeout=timeout)
        return answers.record(answer)

    async def _ask(self, ask: Ask) -> FleetRecord | ErrorInfo:
        """A step of ending a change; deciding may take as long as a load."""
        return await self._step(ask, 60.0 if ask.verb is Verb.DECIDE else self.timeout)

    async def recover(self, change: str = "", boards: Iterable[str] = ALL) -> dict[str, Outcome]:
        """End changes whose coordinator is gone, by the boards' records; returns each change's outcome, by its name.

        A majority of the seats of a change can decide it, or any board that knows the decision. Without `change`: all
        that are open on these boards and whose time is over; with it that one, at once. An outcome whose decision is
        None has too few seats left: its boards are named, and keep waiting. Raises NoSuchBoard, NotFound (no board has
        that change).
        """
        records = open_changes(await self.status(boards), change)
        outcomes = await asyncio.gather(*(recovered(record, self._ask) for record in records.values()))
        return dict(zip(records, outcomes, strict=True))

    async def settle(self, change: str, keep: bool, boards: Iterable[str] = ALL) -> dict[str, FleetRecord | ErrorInfo]:
        """Decide in place of seats that will never come back: if they do, they may contradict it.

        Returns the record of each board, or its error. Raises NoSuchBoard, NotFound (no board has that change),
        InvalidRequest if the change is decided, or can be decided without this, differently.
        """
        (record,) = open_changes(await self.status(boards), change).values()
        await refuse_other(record, keep, self._ask)
        step = FleetStep(change, seats=record.seats, keep=keep)
        chosen = await self.chosen(boards)
        said = await asyncio.gather(*(self._ask(Ask(name, Verb.DECIDE, step)) for name in chosen))
        return dict(zip(chosen, said, strict=True))

    async def push(
        self, archive: str | os.PathLike[str], boards: Iterable[str] = ALL, *, timeout: float = 600.0
    ) -> dict[str, BundleState | ErrorInfo]:
        """Have boards fetch an archive of ``cm build collect`` from here and put it in force.

        `timeout` in seconds, for all of it. Parts that have reached a board stay there: a repeated push continues.
        Raises NoSuchBoard, NotFound (no such file), OSError.
        """
        path = Path(archive)
        bundle = await asyncio.to_thread(bundles.described, path)
        chosen = await self.chosen(boards)
        with bundles.offered(self.session, path, bundle):
            asked = (self.do("bundle", name, wire.encode_fetch(bundle), timeout=timeout) for name in chosen)
            said = await asyncio.gather(*asked)
        return {n: answers.bundle(a) for n, a in zip(chosen, said, strict=True)}
