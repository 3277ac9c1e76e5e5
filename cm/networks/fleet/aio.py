# SPDX-License-Identifier: Apache-2.0
"""The asyncio client of a fleet; `cm.fleet.connect` is the blocking one, with the same names."""

from __future__ import annotations

import asyncio
import dataclasses
import fnmatch
import os
import secrets
import time
from collections.abc import AsyncIterator, Callable, Generator, Iterable, Mapping
from contextlib import asynccontextmanager, suppress
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any

from cm.client.core.calls import write_data, write_registers
from cm.client.errors import request_error
from cm.client.frame import Frame, frame_of
from cm.errors import InvalidRequest
from cm.home import account
from cm.networks.fleet import bundles, keys, queries
from cm.networks.fleet.coordinator import Coordinator, Course, Progress, nothing
from cm.networks.fleet.errors import ChangeFailed, FleetRefused, NoSuchBoard
from cm.networks.fleet.keeper import opened_store
from cm.networks.fleet.presence import Presence
from cm.networks.fleet.queries import AWAY, SILENT, Answer
from cm.networks.fleet.store import (
    BOARDS,
    Entry,
    Put,
    Settings,
    StoreAway,
    StoreRefused,
    View,
    key,
    packed,
    views,
)
from cm.networks.fleet.zenoh_session import Network, closed, from_environment, metadata_of, session
from cm.wire import fleet as wire
from cm.wire import topics
from cm.wire.encode import decode_event, decode_reply, decoded, encode_request, encoded
from cm.wire.messages.fleet import BoardStatus, BundleState, Decision, FleetState, FleetStep, Policy
from cm.wire.messages.status import ErrorInfo, FrameInfo, PlanInfo, RegValues

ALL = ("*",)  # boards
ABSENT = ("refuse", "go-on")
_LEAST = 0.05  # seconds for an answer


def connect(
    router: str | Iterable[str] = (),
    *,
    config: str | os.PathLike[str] | None = None,
    caller: str = "",
    timeout: float = 10.0,
    store: str = "",
) -> Fleet:
    """A fleet, to be entered with ``async with``, or awaited; ``with`` for the blocking one.

    ``with cm.fleet.connect("tcp/router:7447") as fleet: fleet.mode("edge_detection")``. `router`: zenoh's
    ``tcp/host:port`` or ``tls/host:port`` (default: `$CM_FLEET`, or else whoever is found on this network). `config`: a
    file of zenoh's settings, as ``cm fleet keys`` writes them. `caller`: the name to make requests under; with
    certificates, the one in your own, else this user's. `timeout`: seconds for an answer. `store`: where the wanted
    state is, "keeper", etcd's URLs or a file about it (default: `$CM_FLEET_STORE`, or what `config` says, or the
    keeper). Raises NoNetwork, InvalidRequest for a caller's name that cannot be part of a key.
    """
    routers = (router,) if isinstance(router, str) else tuple(router)
    if not routers and config is None:
        routers = from_environment()
    network = Network(connect=routers, config=Path(config) if config else None, store=store)
    return Fleet(network, caller or metadata_of(network.config, "name") or account(f"uid-{os.getuid()}"), timeout)


class Fleet:
    """Many boards. Groups of them are given by name, glob (``line1-*``) or label (``@camera``); by default all.

    `boards` is one of these or several; of none InvalidRequest is raised.
    """

    def __init__(self, network: Network, caller: str, timeout: float) -> None:
        self.caller = keys.check(caller, "caller")  # requests are made under it: managers know it as zenoh:<name>
        self.timeout = timeout
        self._network = network
        self._known: Mapping[str, Entry] = {}  # what our last change left in the store
        self.session: Any = None

    async def __aenter__(self) -> Fleet:
        self.session = await asyncio.to_thread(session, self._network)
        self._store = opened_store(self._network, self.session, self.caller)
        self._presence = Presence()
        try:
            await self._presence.begin(self.session, self.timeout)
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
            await self._store.close()
            await asyncio.to_thread(closed, self.session)

    # ---- who is there -----------------------------------------------------------------------

    async def boards(self) -> tuple[str, ...]:
        """Names of all boards whose bridges are running, sorted."""
        return tuple(sorted(self._presence.boards))

    async def inventory(self) -> dict[str, View]:
        """The boards of the fleet, there or away, sorted: each with its settings and with what is wanted of it.

        Raises StoreAway.
        """
        try:
            return _listed(views(await asyncio.wait_for(self._store.get(BOARDS), self.timeout)))
        except asyncio.TimeoutError:
            raise StoreAway(f"the fleet's store did not answer within {self.timeout:g} s") from None

    async def chosen(self, boards: str | Iterable[str] = ALL) -> tuple[str, ...]:
        """The boards of a group, sorted, from the inventory. Raises NoSuchBoard for a part of it that matches none."""
        return self._matching(boards, await self.inventory())

    def _matching(self, boards: str | Iterable[str], known: Mapping[str, View], exist: bool = True) -> tuple[str, ...]:
        """`exist`: False: also those that are there and not in the inventory, and any that are given by name."""
        there = {*known} if exist else {*known, *self._presence.boards}
        found: set[str] = set()
        for group in _groups(boards):
            if group.startswith("@"):
                members = {n for n, view in known.items() if view.settings and group[1:] in view.settings.labels}
            else:
                members = set(fnmatch.filter(there, group)) or ({group} if not exist and _is_name(group) else set())
            if not members:
                loose = ", ".join(sorted(self._presence.boards - {*known}))
                raise NoSuchBoard(
                    f"no board of the inventory is called or labelled {group}; it has {', '.join(known) or 'none'}"
                    + (f" (there, but not in it: {loose}; `cm fleet add` puts them in)" if loose else "")
                )
            found |= members
        return tuple(sorted(found))

    async def meant(self, boards: str | Iterable[str]) -> tuple[str, ...]:
        """The boards of a group for what is no change: of names, those; of ``*``, all that are there, store or not."""
        groups = _groups(boards)
        if groups == ALL:
            return await self.boards()
        if not all(map(_is_name, groups)):
            return await self.chosen(groups)
        return tuple(sorted(keys.check(name, "board") for name in groups))

    # ---- looking ------------------------------------------------------------------------------

    async def status(self, boards: str | Iterable[str] = ALL) -> dict[str, BoardStatus | ErrorInfo]:
        """The status of each board, or why there is none (code ``no_answer``, or what its manager said).

        By default of all that are there or in the inventory; if the store is away, of those that are there. Raises
        NoSuchBoard for a glob or a label that matches none; a name that does not exist gets an error.
        """
        found = await self._each("status", boards)
        if _groups(boards) == ALL:
            with suppress(StoreAway, StoreRefused):
                away = {name: Answer(name, error=AWAY) for name in await self.inventory()}
                found = dict(sorted({**away, **found}.items()))
        return {n: a.error or wire.board_status(a.payload) for n, a in found.items()}

    async def plan(
        self, mode: str = "", config: str = "", boards: str | Iterable[str] = ALL
    ) -> dict[str, PlanInfo | ErrorInfo]:
        """What a change would do on each board, in steps, bytes and seconds; touches nothing.

        Without `mode` to the default mode, without `config` of the loaded configuration. Raises NoSuchBoard.
        """
        words = f"config?plan={mode}" + (f";config={config}" if config else "")
        found = await self._each(words, boards, max(self.timeout, 30.0))
        return {n: a.error or decoded(PlanInfo, a.payload) for n, a in found.items()}

    async def read(self, register: str, boards: str | Iterable[str] = ALL) -> dict[str, RegValues | ErrorInfo]:
        """A register, or ``register.field``, of each board. Raises NoSuchBoard, InvalidRequest (a name with ``/``)."""
        found = await self._each(f"reg/{keys.check(register, 'register')}", boards)
        return {n: a.error or decoded(RegValues, a.payload) for n, a in found.items()}

    @asynccontextmanager
    async def watch(self, boards: str = "*") -> AsyncIterator[AsyncIterator[tuple[str, BoardStatus | None]]]:
        """Statuses of boards as they change, and each second; None when a board has gone, or says nothing for 10 s, as
        its manager is down. One name or ``*``.

        If more than a thousand wait to be read, the oldest are lost.
        """
        async with self._presence.statuses(self.session, boards) as statuses:
            yield statuses

    async def _each(self, rest: str, boards: str | Iterable[str], timeout: float = 0.0) -> dict[str, Answer]:
        """An answer for each board; one that is absent or does not answer gets an error that says so."""
        found = self._answers(rest, await self.meant(boards), timeout=timeout or self.timeout)
        return dict(sorted([(answer.board, answer) async for answer in found]))

    async def _answers(
        self, rest: str, boards: Iterable[str], payload: bytes = b"", *, timeout: float
    ) -> AsyncIterator[Answer]:
        """The same, as they come: of all that are there, asked for with one query.

        Who does not answer that is asked by name. Rules match by inclusion: a caller that may query some boards but not
        all gets nothing at all for ``*``.
        """
        end, left = time.monotonic() + timeout, {*boards}
        if len(left) > 1 and left == self._presence.boards:
            async for answer in queries.answers(self.session, keys.key("*", rest), payload, timeout=timeout):
                if answer.board in left:
                    left.remove(answer.board)
                    yield answer
        until = max(_LEAST, end - time.monotonic())
        asked = [asyncio.ensure_future(self._one(n, keys.key(n, rest), payload, timeout=until)) for n in sorted(left)]
        try:
            for each in asyncio.as_completed(asked):
                yield await each
        finally:
            for task in asked:
                task.cancel()

    async def _one(
        self, board: str, where: str, payload: bytes = b"", beside: bytes | None = None, *, timeout: float
    ) -> Answer:
        """A board's answer, or an error that says why there is none."""
        found = [each async for each in queries.answers(self.session, where, payload, beside, timeout)]
        if found:
            return dataclasses.replace(found[0], board=board)
        return Answer(board, error=SILENT if board in self._presence.boards else AWAY)

    # ---- the inventory --------------------------------------------------------------------------

    async def add(self, boards: str | Iterable[str]) -> tuple[str, ...]:
        """Put boards into the inventory, by name or, if they are there, by glob; returns those that are new in it.

        Raises NoSuchBoard for a glob that matches none.
        """
        known = await self.inventory()
        found = [name for name in self._matching(boards, known, exist=False) if name not in known]
        for name in found:
            puts = {key(keys.check(name, "board"), "settings"): Put(packed(Settings()))}
            await self._store.txn({key(name, "settings"): 0}, puts)
        return tuple(found)

    async def remove(self, boards: str | Iterable[str]) -> tuple[str, ...]:
        """Take boards out of the inventory, and forget what is wanted of them. Raises NoSuchBoard, StoreRefused.

        A board of a certificate that is still running puts itself in again.
        """
        known = await self.inventory()
        found = self._matching(boards, known)
        for name in found:
            view = known[name]
            expect = {key(name, part): view.revision(part) for part in ("wanted", "claim")}
            puts = dict.fromkeys(key(name, part) for part in ("settings", "wanted"))
            done = not view.open and await self._store.txn(expect, puts)
            if not done and name in await self.inventory():  # not there: done, and asked again as the answer was lost
                raise StoreRefused(f"a change is open on {name}: wait for its end")
        return found

    async def stored(self) -> dict[str, Entry]:
        """Everything in the store, as it lies there."""
        return await self._store.get("")

    async def reconcile(self, boards: str | Iterable[str] = ALL) -> dict[str, FleetState | ErrorInfo]:
        """Have boards go to what is wanted of them now: also if somebody took them elsewhere, or it failed before.

        Returns each board's state, or its error. Raises NoSuchBoard.
        """
        found = self._steps(max(60.0, self.timeout), await self.meant(boards), "reconcile", FleetStep(keys.AGAIN))
        return dict(sorted([each async for each in found]))

    # ---- changing -------------------------------------------------------------------------------

    async def do(
        self, verb: str, board: str, message: bytes, data: bytes | None = None, timeout: float = 0.0
    ) -> Answer:
        """A command for one board, in this caller's name: `message` is serialised, `data` is the payload beside it.

        The answer's payload is a Reply; it has an error if none came within `timeout` seconds (0: the fleet's).
        """
        where = keys.key(keys.check(board, "board"), keys.command(verb, self.caller))
        payload, attachment = (message, None) if data is None else (data, message)
        return await self._one(board, where, payload, attachment, timeout=timeout or self.timeout)

    async def write(
        self, values: Mapping[str, int | str], boards: str | Iterable[str] = ALL
    ) -> dict[str, RegValues | ErrorInfo]:
        """Write registers on each board, in order; each board does all of it or nothing, and answers for itself.

        Raises NoSuchBoard.
        """
        message = bytes(encode_request(write_registers(values).request)[1])
        names = await self.meant(boards)
        answers = await asyncio.gather(*(self.do("reg", name, message) for name in names))
        return {name: queries.said(answer, RegValues) for name, answer in zip(names, answers, strict=True)}

    async def frame(self, board: str, stream: str) -> Frame:
        """The next frame of a stream of one board, as an array of the stream's shape. Raises RequestFailed."""
        answer = await self._one(board, keys.key(board, "frames", stream), timeout=self.timeout)
        if answer.error is not None:
            raise request_error(_named(board, answer.error))
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
            raise request_error(_named(board, error))

    async def load(
        self,
        config: str = "",
        mode: str = "",
        boards: str | Iterable[str] = ALL,
        *,
        policy: Policy | str = Policy.ALL,
        absent: str = "",
        timeout: float = 60.0,
        tell: Progress = nothing,
    ) -> Course:
        """Take boards to a mode, or none: prepare all, change all, then one transaction of the store decides.

        `policy`: ``all``, ``quorum`` or ``best-effort``: how many boards must succeed for the change to be kept.
        `absent`, for boards of the inventory that are away: ``refuse`` (default under ``all``), or ``go-on`` (default
        otherwise): then they are named, and go there when they are back.
        `timeout`: seconds for each phase. `tell` is called with the phase, a board, and its answer; in another thread,
        if this is the blocking client. Returns the course with the critical path. Raises NoSuchBoard, StoreAway, Busy
        (another change is open there), FleetRefused (nothing was touched), ChangeFailed (not every named board is
        there; its course names each). If this is cancelled or killed at any moment, boards go on by themselves.
        """
        rule = Policy.of(policy)
        absent = absent or ("refuse" if rule is Policy.ALL else "go-on")

        def choose(known: Mapping[str, View]) -> tuple[tuple[str, ...], dict[str, ErrorInfo]]:
            chosen = self._matching(boards, _listed(known))
            return chosen, self._away(chosen, absent)

        change, ask = f"{self.caller}-{secrets.token_hex(4)}", partial(self._steps, timeout)
        coordinator = Coordinator(self._store, ask, self.caller, change, choose, config, mode, rule, tell)
        coordinator.known, self._known = self._known, {}
        course = await coordinator.run()
        self._known = coordinator.known
        if course.decision is Decision.REVERT and not course.touched:
            raise FleetRefused(course.causes)
        if course.differing or course.decision is not Decision.KEEP:
            raise ChangeFailed(course)
        return course

    async def mode(
        self,
        mode: str,
        boards: str | Iterable[str] = ALL,
        *,
        policy: Policy | str = Policy.ALL,
        absent: str = "",
        timeout: float = 60.0,
        tell: Progress = nothing,
    ) -> Course:
        """Take boards to a mode of what they have loaded, or none; as `load`."""
        return await self.load("", mode, boards, policy=policy, absent=absent, timeout=timeout, tell=tell)

    def _away(self, chosen: Iterable[str], absent: str) -> dict[str, ErrorInfo]:
        """Boards that are not there, under the policy about them. Raises FleetRefused, InvalidRequest."""
        if absent not in ABSENT:
            raise InvalidRequest(f"boards that are away: one of {', '.join(ABSENT)} is wanted, not {absent!r}")
        gone = dict.fromkeys(sorted({*chosen} - self._presence.boards), AWAY)
        if gone and absent != "go-on":
            raise FleetRefused(gone)
        return gone

    async def _steps(
        self, timeout: float, boards: Iterable[str], verb: str, step: FleetStep
    ) -> AsyncIterator[tuple[str, FleetState | ErrorInfo]]:
        """A step of each board, which may be asked twice for it: nothing is done twice."""
        command, message = keys.command(verb, self.caller), encoded(step)
        async for answer in self._answers(command, boards, message, timeout=timeout):
            yield answer.board, queries.said(answer, FleetState)

    async def push(
        self,
        archive: str | os.PathLike[str],
        boards: str | Iterable[str] = ALL,
        *,
        timeout: float = 600.0,
        tell: Callable[[int, int], None] | None = None,
    ) -> dict[str, BundleState | ErrorInfo]:
        """Have boards fetch an archive of ``cm build collect`` from here and put it in force.

        `timeout` in seconds, for all of it. What has reached a board stays there: a repeated push continues. `tell` is
        called each second with the bytes that were sent so far and those of all boards; in another thread, if this is
        the blocking client.
        Raises NoSuchBoard, NotFound (no such file), OSError.
        """
        path = Path(archive)
        bundle = await asyncio.to_thread(bundles.described, path)
        chosen = await self.meant(boards)
        with bundles.offered(self.session, path, bundle) as sent:

            async def each_second() -> None:
                while tell:
                    await asyncio.sleep(1.0)
                    tell(sent(), len(chosen) * bundle.length)

            telling = asyncio.create_task(each_second())
            command, message = keys.command("bundle", self.caller), encoded(bundle)
            try:
                found = [a async for a in self._answers(command, chosen, message, timeout=timeout)]
            finally:
                telling.cancel()
        return {a.board: queries.said(a, BundleState) for a in sorted(found, key=lambda a: a.board)}


def _listed(known: Mapping[str, View]) -> dict[str, View]:
    """The boards of the inventory, of those of the store."""
    return {name: view for name, view in known.items() if view.settings is not None}


def _named(board: str, error: ErrorInfo) -> ErrorInfo:
    """The error with its board in the sentence, for where nothing else names it."""
    return ErrorInfo(error.code, f"{board}: {error.message}")


def _groups(boards: str | Iterable[str]) -> tuple[str, ...]:
    """Raises InvalidRequest for none: a program that found none to change does not mean all of them."""
    found = (boards,) if isinstance(boards, str) else tuple(boards)
    if not found:
        raise InvalidRequest("no board is named; '*' are all of them")
    return found


def _is_name(group: str) -> bool:
    return not group.startswith("@") and not keys.WILD & set(group) and "[" not in group
