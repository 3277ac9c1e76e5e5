# SPDX-License-Identifier: Apache-2.0
"""The bridge: one event loop between a manager and the fleet's network."""

from __future__ import annotations

import asyncio
import logging
import os
import time
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from cm.client.aio.relay import Relay
from cm.client.core import calls
from cm.client.errors import NotAdmitted
from cm.errors import Busy, CmError, NotInstalled
from cm.home import state_home
from cm.networks.fleet import keys
from cm.networks.fleet.bridge.bundles import Bundles, Import
from cm.networks.fleet.bridge.managed_board import ManagedBoard, seen
from cm.networks.fleet.bridge.notes_file import NotesFile
from cm.networks.fleet.bridge.publishing import BEAT, Publications
from cm.networks.fleet.bridge.query_answers import Queries
from cm.networks.fleet.keeper import Keeper, opened_store
from cm.networks.fleet.reconciling_board import Board, Seen
from cm.networks.fleet.store import BOARDS, Settings, Store, StoreAway, StoreRefused, packed, views
from cm.networks.fleet.zenoh_session import Network, NoNetwork, closed, hears, is_alive, session
from cm.wire import fleet as wire
from cm.wire import topics
from cm.wire.messages.status import ErrorInfo

_T = TypeVar("_T")
_LOG = logging.getLogger("cm.fleet")
_RECONNECT = 1.0  # seconds between two tries to reach a manager, or the network
_TOGETHER = 0.25  # seconds in which whoever changes the fleet asks anyway: then nothing is left to be looked at
_HEAR, _LISTEN, _ANSWER = 120.0, 10.0, 5.0  # seconds between two questions to ourselves; after a change; for an answer


@dataclass(frozen=True, slots=True)
class Options:
    """What a bridge is started with; the first three are those of `cm.connect`."""

    network: Network
    state: Path
    endpoint: str | None = None
    runtime_dir: Path | None = None
    keys: Path | None = None
    name: str = ""  # of the board; empty: the manager's name for it
    labels: tuple[str, ...] = ()
    take: Import | None = None  # puts an archive in force; None: none are taken
    joins: bool = False  # puts itself into the inventory
    keeps: bool = False  # is the fleet's keeper


@dataclass
class Bridge:
    """Runs until it is cancelled."""

    options: Options
    ready: Callable[[str], None]
    _status: bytes = b""
    _unread: bool = False  # that status, as far as it concerns us
    _seen: Seen | None = None  # as the manager told last; None while it changes, or is away
    _streams: tuple[str, ...] = ()  # likewise

    async def run(self) -> None:
        """Raises NotAdmitted if the manager does not admit us, Busy if the board's name is taken."""
        relay = await _tried(self._reached)
        try:
            board = keys.check(self.options.name or (await relay.ask(calls.status())).board, "board")
            while True:
                network = await _tried(partial(asyncio.to_thread, session, self.options.network))
                try:
                    await self._serve(board, relay, network)
                except NoNetwork as error:
                    _LOG.warning("%s", error)
                finally:
                    await asyncio.to_thread(closed, network)
        finally:
            await relay.close()

    async def _reached(self) -> Relay:
        relay = Relay(self.options.endpoint, self.options.runtime_dir, self.options.keys, self._manager_changed)
        try:
            await relay.ask(calls.status())
        except BaseException:
            await relay.close()
            raise
        return relay

    def _manager_changed(self, up: bool) -> None:
        self._status, self._seen, self._unread = b"", None, False
        _LOG.info("the manager is %s", "there" if up else "away")

    async def _serve(self, board: str, relay: Relay, network: Any) -> None:
        await _alone(board, network, self.options.network.lease)
        folder = self.options.state / board
        if not self.options.keeps:
            await self._take_part(board, relay, network, folder)
            return
        keeper = await asyncio.to_thread(Keeper, network, folder / "store.sqlite")
        try:
            await self._take_part(board, relay, network, folder, asyncio.wrap_future(keeper.ended))
        finally:
            await asyncio.to_thread(keeper.close)

    async def _take_part(self, board: str, relay: Relay, network: Any, folder: Path, *more: Awaitable[None]) -> None:
        """Until one of the tasks ends, or of `more`: whatever a bridge promises goes on, or it ends as a whole."""
        store = opened_store(self.options.network, network, board)
        managed = ManagedBoard(relay, self._seen_now)
        self._board = Board(board, store, managed, NotesFile(folder), time.monotonic)
        bundles = Bundles(network, folder / "bundles", self.options.take, managed, lambda: self._board.in_a_change)
        publications = Publications(board, network, relay, self._with_extras)
        queries = Queries(board, network, self._board, managed, partial(self._status_now, relay), bundles.fetch)
        token = network.liveliness().declare_token(keys.key(board, "alive"))  # last: who sees it may ask
        self.ready(board)
        told = relay.subscribe(topics.STATUS, topics.READ_REG, topics.IRQ, take=partial(self._told, publications))
        work = (
            relay.refused(), self._beat(publications), self._reconcile(publications),
            self._follow_store(board, store), self._hear(board), *more,
        )  # fmt: skip
        tasks = [asyncio.ensure_future(each) for each in work]
        try:
            await asyncio.gather(*tasks)
        finally:
            token.undeclare()
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            told.close()
            publications.offer_streams(())
            queries.end()
            await store.close()

    # ---- the status -----------------------------------------------------------------------

    async def _status_now(self, relay: Relay) -> bytes:
        if not self._status:
            reply = wire.body((await relay.forward([topics.STATUS, b""], timeout=10.0))[1])
            if isinstance(reply, ErrorInfo):
                raise CmError(reply.message)
            self._status = reply[1]
        return self._with_extras()

    def _with_extras(self) -> bytes:
        return self._status + wire.extras(self.options.labels, self._board.state)

    # ---- what goes on by itself -------------------------------------------------------------

    def _told(self, publications: Publications, frames: list[bytes]) -> None:
        topic, message, *_ = frames
        if topic != topics.STATUS:
            publications.tell(topic, message)
            return
        if not self._unread:
            asyncio.get_running_loop().call_soon(self._pass_on, publications)
        self._status, self._unread = message, True

    def _pass_on(self, publications: Publications) -> None:
        """The newest status, of those that came together."""
        if not self._status:  # the manager has just gone
            return
        seen = self._seen_now()
        if seen is not None:
            self._board.seen(seen.place)
        publications.offer_streams(self._streams)
        publications.tell_status()

    def _seen_now(self) -> Seen | None:
        if self._unread:
            self._unread = False
            self._streams, told = wire.glance(self._status)
            self._seen = seen(*told) if told else None
        return self._seen

    async def _beat(self, publications: Publications) -> None:
        while True:
            if self._status:
                publications.beat()
            self._board.remind()
            await asyncio.sleep(BEAT)

    async def _follow_store(self, board: str, store: Store) -> None:
        """Look whenever something of this board changes in the store; be in its inventory first."""
        own, said = Settings(self.options.labels), False
        async for changes in store.watch(f"{BOARDS}{board}/"):
            self._board.told(changes)
            if said and self._board.listed:
                continue
            with suppress(StoreAway, StoreRefused):
                known = views(await store.get(f"{BOARDS}{board}/")).get(board)
                listed = known is not None and known.settings is not None
                if (self.options.joins or listed) and not (known and known.settings == own):
                    await store.join(board, packed(own))
                said = True

    async def _reconcile(self, publications: Publications) -> None:
        said = ""
        while True:
            await self._board.wake.wait()
            await asyncio.sleep(_TOGETHER)
            if not self._board.wake.is_set():
                continue
            before = self._board.state
            problem = await self._board.look()
            if problem and problem != said:
                _LOG.warning("what the fleet wants: %s", problem)
            said = problem
            if self._status and self._board.state != before:
                publications.tell_status()

    async def _hear(self, board: str) -> None:
        """Ask ourselves, as others do, now and then and after each change. Raises NoNetwork if nothing comes twice.

        Who never heard itself has rules, or a network, that let it not. After the middle of a network stood still, a
        session may be up on both sides, and bring nothing any more.
        """
        asked = [keys.key(board, "alive"), *([f"{keys.STORE}/get/{board}"] if self.options.keeps else ())]
        missed, before, last, quiet_until = 0, False, self._board.state, 0.0
        while missed < 2:
            await asyncio.sleep(_RECONNECT if missed else _LISTEN)
            if not missed and self._board.state == last and time.monotonic() < quiet_until:
                continue
            heard = await asyncio.to_thread(hears, self.options.network, asked, _ANSWER)
            before, last = before or bool(heard), self._board.state
            quiet_until = time.monotonic() + (0.0 if heard is None else _HEAR)
            missed = missed + 1 if before and heard is False else 0
        raise NoNetwork("the network brings us nothing any more: the session is opened anew")


async def _tried(work: Callable[[], Awaitable[_T]]) -> _T:
    """Until it is done; each new obstacle is logged. Raises NotAdmitted, NotInstalled."""
    said = ""
    while True:
        try:
            return await work()
        except (NotAdmitted, NotInstalled):
            raise
        except CmError as error:
            if str(error) != said:
                _LOG.warning("%s; it is tried again", error)
            said = str(error)
        await asyncio.sleep(_RECONNECT)


async def _alone(board: str, network: Any, lease: float) -> None:
    """Two bridges with one name would both carry out a request. Raises Busy.

    After a loss of power the old token stays for as long as a process may hang: `lease` seconds.
    """
    end, told = time.monotonic() + 1.5 * lease + 1, False
    while await asyncio.to_thread(is_alive, network, keys.key(board, "alive")):
        if time.monotonic() > end:
            raise Busy(f"a board called {board!r} is in this fleet already: give this one another --name")
        if not told:
            _LOG.warning("a board called %s is in this fleet: if that was this one, it will be gone soon", board)
        told = True
        await asyncio.sleep(_RECONNECT)


def default_state() -> Path:
    """The service's folder (`$STATE_DIRECTORY`), or else `$XDG_STATE_HOME`/cm/fleet, for root /var/lib/cm/fleet."""
    if service := os.environ.get("STATE_DIRECTORY"):
        return Path(service) / "fleet"
    with suppress(AttributeError):
        if os.geteuid() == 0:
            return Path("/var/lib/cm/fleet")
    return state_home() / "cm" / "fleet"
