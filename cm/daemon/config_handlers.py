# SPDX-License-Identifier: Apache-2.0
"""Handlers of requests that list, send and remove configurations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from cm.daemon.host.provision import Provisioner
from cm.daemon.host.sent import Sender
from cm.daemon.sessions import Sessions
from cm.manager.errors import ChangeBusy
from cm.manager.manager import Manager
from cm.manager.reporting.descriptions import config_list
from cm.messages.status import ConfigInfo
from cm.rights.gate import check
from cm.rights.model import Role
from cm.rights.needs import provisioning


class SentConfigs:
    """What clients sent, and who may do what with it. The loop's thread."""

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
        """Who sends over a connection."""
        who = self._sessions.gate.principal(connection)
        return Sender(who.account, str(who), self._sessions.gate.everywhere(connection) >= Role.ADMIN)

    def allowed(self, connection: str) -> Callable[[str], None]:
        """Asked in another thread about a configuration's name, once it is known. It raises Forbidden, ChangeBusy."""
        who, rights = self._sessions.gate.principal(connection), self._sessions.gate.rights(connection)

        def ask(name: str) -> None:
            check(who, rights, provisioning(name))
            self._manager.check_replaceable(name)

        return ask

    def check_removable(self, name: str) -> None:
        """Raise ChangeBusy while a configuration is loaded, or a change may need it."""
        if self._manager.in_use(name):
            raise ChangeBusy(f"configuration {name!r} is in use; load another first")
