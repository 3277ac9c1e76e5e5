# SPDX-License-Identifier: Apache-2.0
"""Handlers of requests that describe, list, send and remove configurations."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

from cm.manager.errors import ChangeBusy
from cm.manager.manager import Manager
from cm.manager.reporting import config_list, is_long
from cm.server.connections import Sessions
from cm.server.data_handlers import MemoryTransfers
from cm.server.provision import Provisioner, Sender
from cm.server.rights.gate import check
from cm.server.rights.model import Role
from cm.server.rights.needs import provisioning
from cm.wire.encode import encode_config
from cm.wire.messages.status import ConfigInfo


class Description:
    """What a client is told of a configuration. Of a long one that takes 0.15 s, and is done beside the loop."""

    def __init__(self, manager: Manager, memories: MemoryTransfers, name: str, counts: Mapping[str, int]) -> None:
        """`name` is empty for the loaded one; `counts` of its interrupts."""
        self._manager = manager
        self._memories = memories
        self._name = name
        self._counts = counts

    @property
    def is_long(self) -> bool:
        """Whether it takes longer than a request may."""
        return is_long(self._manager.configs.get(self._name or self._manager.state.config or ""))

    def info(self) -> ConfigInfo:
        """Any thread. Raises UnknownConfig, NothingLoaded."""
        return self._memories.described(self._manager.describe(self._name, self._counts))

    def encoded(self) -> bytes:
        """The same, as it stands in the reply."""
        return encode_config(self.info())


class SentConfigs:
    """Configurations that clients sent, and who may do what with them. The loop's thread."""

    def __init__(self, manager: Manager, provisioner: Provisioner, sessions: Sessions) -> None:
        self._manager = manager
        self._provisioner = provisioner
        self._sessions = sessions

    def listed(self) -> ConfigInfo:
        """All configurations, with their origins."""
        listed, owned = config_list(self._manager.configs), self._provisioner.owned
        reserved = self._provisioner.reserved
        entries = []
        for entry in listed.entries:
            whose = None if entry.name in reserved else owned.get(entry.name)
            said = ("client", whose.name, whose.bytes) if whose else ("administrator", "", 0)
            entries.append(replace(entry, origin=said[0], owner=said[1], bytes=said[2]))
        return replace(listed, entries=tuple(entries))

    def sender(self, connection: str) -> Sender:
        """The sender on a connection."""
        who = self._sessions.gate.principal(connection)
        return Sender(who.account, str(who), self._sessions.gate.everywhere(connection) >= Role.ADMIN)

    def allowed(self, connection: str) -> Callable[[str], None]:
        """The check of a configuration's name, made in another thread once it is known: Forbidden, ChangeBusy."""
        who, rights = self._sessions.gate.principal(connection), self._sessions.gate.rights(connection)

        def ask(name: str) -> None:
            check(who, rights, provisioning(name))
            self._manager.check_replaceable(name)

        return ask

    def check_removable(self, name: str) -> None:
        """Raise ChangeBusy while a configuration is loaded, or a change may need it."""
        if self._manager.in_use(name):
            raise ChangeBusy(f"configuration {name!r} is in use; load another first")
