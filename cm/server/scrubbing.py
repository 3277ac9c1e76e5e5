# SPDX-License-Identifier: Apache-2.0
"""Regions that are compared again and again, as `scrub` of the settings says, and what is done where one is wrong.

A pass goes slice by slice (`cm.manager.execution.region_readback`), with a pause after each that keeps it within its
budget, and never beside a change: slices and changes have the same thread.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from functools import partial

from cm.errors import CmError
from cm.manager.execution.region_readback import Checked, Pace
from cm.manager.manager import Manager
from cm.manager.state.board_state import RegionPhase
from cm.server.settings.model import ScrubSettings
from cm.server.sockets import Loop
from cm.wire.messages.requests import CheckRegion
from cm.wire.messages.status import RegionCheck

_LOG = logging.getLogger("cm")


class Scrubber:
    """One per manager; the loop's thread, but for what `thread` does."""

    def __init__(self, loop: Loop, manager: Manager, thread: Executor, settings: Mapping[str, ScrubSettings]) -> None:
        self._loop, self._manager, self._thread = loop, manager, thread
        self._settings = settings
        self._said: dict[str, str] = {}  # the last refusal by region, which is logged once
        self._under_way: set[str] = set()  # regions whose pass, or what it led to, has not ended

    def begin(self) -> None:
        """From now on."""
        known = {name for config in self._manager.configs.values() for name in config.regions}
        for name, said in self._settings.items():
            if name not in known:
                _LOG.warning("settings: scrub names a region %s, which no configuration has", name)
            self._loop.call_later(said.every, partial(self._pass, name))

    def _pass(self, name: str) -> None:
        """Begin a pass, if the one before has ended; asked as often as the settings say."""
        self._loop.call_later(self._settings[name].every, partial(self._pass, name))
        held = self._manager.state.region(name)
        if name in self._under_way or held.phase is not RegionPhase.READY or held.module is None:
            return
        self._under_way.add(name)
        self._thread.submit(partial(self._prepare, name))

    def _prepare(self, name: str) -> None:
        """In the thread of files: what the region holds is read once, and kept."""
        try:
            what: Checked | CmError | OSError = self._manager.prepared_check(name)
        except (CmError, OSError) as error:
            what = error
        self._loop.call_threadsafe(partial(self._check, name, what))

    def _check(self, name: str, what: Checked | CmError | OSError) -> None:
        if isinstance(what, Exception):
            self._end_pass(name, what)
            return
        ended = partial(self._end_pass, name)
        try:
            self._manager.check(what, lambda found: self._loop.call_threadsafe(partial(ended, found)), self._pace(name))
        except CmError as error:
            ended(error)

    def _pace(self, name: str) -> Pace:
        budget = self._settings[name].budget

        def pause(seconds: float, go_on: Callable[[], None]) -> None:
            wait = seconds * (1 / budget - 1)
            self._loop.call_threadsafe(lambda: self._loop.call_later(wait, go_on))

        return pause

    def _end_pass(self, name: str, found: RegionCheck | Exception) -> None:
        if isinstance(found, Exception):
            self._log_refusal(name, found)
            self._under_way.discard(name)
            return
        self._said.pop(name, None)
        if found.verdict != "wrong":
            self._under_way.discard(name)
            return
        policy = self._settings[name].policy
        _LOG.warning(
            "region %s (%s): %s bits in %s frames are wrong; policy: %s",
            name, found.module, found.wrong_bits, found.wrong_frames, policy,
        )  # fmt: skip
        if policy == "tell":
            self._under_way.discard(name)
            return
        done = partial(self._loop.call_threadsafe, partial(self._under_way.discard, name))
        why = f"as bits of region {name} were wrong (scrub)"
        try:
            self._manager.repair(CheckRegion(name, repair=True), lambda _: done(), why=why)
        except CmError as error:
            self._log_refusal(name, error)
            self._under_way.discard(name)

    def _log_refusal(self, name: str, error: Exception) -> None:
        if self._said.get(name) != str(error):
            self._said[name] = str(error)
            _LOG.warning("region %s is not compared: %s", name, error)
