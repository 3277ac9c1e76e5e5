# SPDX-License-Identifier: Apache-2.0
"""Schemas and settings read again while the manager serves, without touching what runs."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from functools import partial

from cm.errors import CmError
from cm.manager.manager import Manager
from cm.schema.model import Config
from cm.server.options import Options, Reloaded
from cm.server.systemd import ServiceManager

_LOG = logging.getLogger("cm")


class Reloader:
    """Reads in another thread and applies in the loop's: everything, or nothing if reading fails.

    A configuration that is loaded, or being loaded, keeps the schema that it was loaded with. Its new schema waits
    until the board holds another configuration, or until all of it is loaded again by force.
    """

    def __init__(
        self,
        options: Options,
        manager: Manager,
        service: ServiceManager,
        in_thread: Callable[[Callable[[], None]], object],
        in_loop: Callable[[Callable[[], None]], None],
        apply: Callable[[Reloaded], None],
        standing: Callable[[Mapping[str, Config]], Mapping[str, Config]],
        complete: Callable[[Config], Config],
    ) -> None:
        """`apply`: settings to what they bound; `standing`: configurations together with those that clients sent.

        Configurations of the start that a later reading lacks are forgotten.
        """
        self._manager, self._service, self._in_thread, self._in_loop = manager, service, in_thread, in_loop
        self._apply_settings, self._standing, self._complete = apply, standing, complete
        self._reread, self._stamp = options.reload, options.changed
        self._waiting: dict[str, Config | None] = {}  # None: to be forgotten
        self._ours = frozenset(options.configs)
        self._stamps = self._stamp() if self._stamp else None
        self._stale = False  # something has changed, and may be changing still

    def begin(self) -> None:
        """Read, then apply; the service manager is told of the beginning and the end."""
        if self._reread is not None:
            self._service.reloading()
            self._in_thread(partial(self._read, self._reread))

    def poll(self) -> None:
        """Begin by itself once settings or keys have changed, and then not for the time between two looks."""
        if self._stamp is None:
            return
        now = self._stamp()
        if now != self._stamps:
            self._stamps, self._stale = now, True
        elif self._stale:
            self._stale = False
            self.begin()

    def _read(self, read: Callable[[], Reloaded]) -> None:
        try:
            found = read()
            standing = self._standing(found.configs)
        except (CmError, OSError) as error:
            _LOG.error("not reloaded: %s", error)
            self._in_loop(self._service.ready)
            return
        self._in_loop(lambda: self._apply(found, standing))

    def _apply(self, found: Reloaded, standing: Mapping[str, Config]) -> None:
        self._apply_settings(found)
        # A damaged schema has no name, so as long as there is one, no known configuration counts as removed.
        hidden = self._ours - found.configs.keys()
        gone = hidden - standing.keys() if found.whole else frozenset()
        kept = frozenset() if found.whole else hidden
        known = {name: (config.source, config.sha256_source) for name, config in self._manager.configs.items()}
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
        self._service.ready()

    def continue_waiting(self) -> None:
        """Apply schemas that wait and whose configuration is no longer in use; called now and then."""
        for name in [name for name in self._waiting if not self._manager.in_use(name)]:
            if self._waiting[name] is not None:
                self.renew(name)
            else:
                del self._waiting[name]
                self._manager.forget_config(name)

    def renew(self, name: str) -> None:
        """Apply a new schema that waits, though its configuration may be loaded."""
        config = self._waiting.get(name)
        if config is not None and not self._manager.changing:
            del self._waiting[name]
            self._manager.add_config(self._complete(config))
