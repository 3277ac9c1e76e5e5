# SPDX-License-Identifier: Apache-2.0
"""Schemas and settings read again while the manager serves, without touching what runs."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from concurrent.futures import Executor

from cm.errors import CmError
from cm.frozen import dataclass
from cm.manager.manager import Manager
from cm.schema.model import Config
from cm.server.rights.model import Access
from cm.server.settings.model import USUAL, Limits
from cm.server.systemd import ServiceManager

_LOG = logging.getLogger("cm")


@dataclass(frozen=True, slots=True)
class Reloaded:
    """What was read: configurations by name, who may do what and use how much, and which changes need a restart."""

    configs: Mapping[str, Config]
    access: Access
    limits: Limits = USUAL
    notes: tuple[str, ...] = ()
    whole: bool = True  # whether every schema on the search path was valid


@dataclass(frozen=True, slots=True)
class ReloadContext:
    """What a reloader works with. `read` runs in another thread; None: there is nothing to reread."""

    manager: Manager
    renew: Callable[[Reloaded], None]  # applies settings to what they bound
    service: ServiceManager
    thread: Executor
    in_loop: Callable[[Callable[[], None]], None]
    standing: Callable[[Mapping[str, Config]], Mapping[str, Config]]  # together with those that clients sent
    complete: Callable[[Config], Config]
    read: Callable[[], Reloaded] | None
    stamps: Callable[[], object] | None = None


class Reloader:
    """Reads in another thread and applies in the loop's: everything, or nothing if reading fails.

    A configuration that is loaded, or being loaded, keeps the schema that it was loaded with. Its new schema waits
    until the board holds another configuration, or until all of it is loaded again by force.
    """

    def __init__(self, surroundings: ReloadContext, configs: Mapping[str, Config]) -> None:
        """`configs`: those of the start; configurations that a later reading lacks are forgotten."""
        self._s = surroundings
        self._waiting: dict[str, Config | None] = {}  # None: to be forgotten
        self._ours = frozenset(configs)
        self._stamps = surroundings.stamps() if surroundings.stamps else None
        self._stale = False  # something has changed, and may be changing still

    def begin(self) -> None:
        """Read, then apply; the service manager is told of the beginning and the end."""
        if self._s.read is not None:
            self._s.service.reloading()
            self._s.thread.submit(self._read, self._s.read)

    def poll(self) -> None:
        """Begin by itself once settings or keys have changed, and then not for the time between two looks."""
        if self._s.stamps is None:
            return
        now = self._s.stamps()
        if now != self._stamps:
            self._stamps, self._stale = now, True
        elif self._stale:
            self._stale = False
            self.begin()

    def _read(self, read: Callable[[], Reloaded]) -> None:
        try:
            found = read()
            standing = self._s.standing(found.configs)
        except (CmError, OSError) as error:
            _LOG.error("not reloaded: %s", error, extra={"cm_code": getattr(error, "code", "io")})
            self._s.in_loop(self._s.service.ready)
            return
        self._s.in_loop(lambda: self._apply(found, standing))

    def _apply(self, found: Reloaded, standing: Mapping[str, Config]) -> None:
        self._s.renew(found)
        # A damaged schema has no name, so as long as there is one, no known configuration counts as removed.
        hidden = self._ours - found.configs.keys()
        gone = hidden - standing.keys() if found.whole else frozenset()
        kept = frozenset() if found.whole else hidden
        known = {name: (config.source, config.sha256_source) for name, config in self._s.manager.configs.items()}
        new = {n: c for n, c in standing.items() if n not in kept and known.get(n) != (c.source, c.sha256_source)}
        self._waiting = {**dict.fromkeys(gone), **new}
        self._ours = (self._ours - gone) | found.configs.keys()
        self.continue_waiting()
        for name in sorted(self._waiting):
            _LOG.warning(
                "configuration %s is in use; its new version takes effect when another is loaded, or by "
                "cm load %s --force", name, name,
            )  # fmt: skip
        for note in found.notes:
            _LOG.warning("%s", note)
        _LOG.info("reloaded; configurations: %s", ", ".join(found.configs) or "none")
        self._s.service.ready()

    def continue_waiting(self) -> None:
        """Apply schemas that wait and whose configuration is no longer in use; called now and then."""
        for name in [name for name in self._waiting if not self._s.manager.in_use(name)]:
            if self._waiting[name] is not None:
                self.renew(name)
            else:
                del self._waiting[name]
                self._s.manager.forget_config(name)

    def renew(self, name: str) -> None:
        """Apply a new schema that waits, though its configuration may be loaded."""
        config = self._waiting.get(name)
        if config is not None and not self._s.manager.changing:
            del self._waiting[name]
            self._s.manager.add_config(self._s.complete(config))
