# SPDX-License-Identifier: Apache-2.0
"""Where every request is let through or refused. In the thread of the daemon's loop only."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterable

from cm.errors import Forbidden
from cm.frozen import dataclass, replace
from cm.manager.touched import Scene, resolved
from cm.server.rights import policy
from cm.server.rights.audit import Audit, described
from cm.server.rights.model import Access, Need, Rights, Role
from cm.server.rights.policy import Users
from cm.server.rights.principal import CURVE, NOBODY, Principal, from_id, guest_of, introduced, on_behalf
from cm.server.rights.required_rights import Right, needs_of
from cm.wire.messages.requests import Request

_NAME = 64  # characters of a guest's name
_OPERATE = Role.OPERATE  # looking it up in the enum's class takes time
_KEPT = 4096  # connections whose rights are remembered


@dataclass(frozen=True, slots=True)
class _Known:
    """A client, what it may do, and its highest role without limits."""

    who: Principal
    rights: Rights
    everywhere: Role


_UNKNOWN = _Known(NOBODY, policy.NOTHING, Role.NONE)


class Gate:
    """Knows who a client is and what it may do; forgets all of that when the policy is renewed.

    A `connection` is the id of its principal, as it stands beside each of its messages.
    """

    def __init__(self, access: Access, users: Users, now: Callable[[], float] = time.time) -> None:
        self._access = access
        self._users = users
        self._now = now
        self._known: dict[str, _Known] = {}
        self._origins: dict[str, set[Principal]] | None = {}  # who came over TCP, by address
        self._looked = now()
        self.audit = Audit()

    def renew(self, access: Access) -> Callable[[Principal], bool]:
        """Apply another policy from now on; returns a function that tells whether a client's rights have changed."""
        before, self._access = self._access, access
        self._known.clear()

        def changed(who: Principal) -> bool:
            old, new = (policy.rights_of(who, said, self._users) for said in (before, access))
            return old != new

        return changed

    def expired(self) -> frozenset[str]:
        """The keys that have expired since this was asked last."""
        since, self._looked = self._looked, self._now()
        ends = ((key.public, key.until) for key in self._access.keys)
        return frozenset(public for public, until in ends if until is not None and since < until <= self._looked)

    def from_address(self, address: str) -> Iterable[Principal]:
        """All clients that may have come over TCP from an address: every key, if there have been too many."""
        if self._origins is None:
            return [introduced(CURVE, address, "CURVE", key.public) for key in self._access.keys]
        return self._origins.get(address.removeprefix("::ffff:"), ())

    def principal(self, connection: str) -> Principal:
        """Who a connection belongs to."""
        return self._look_up(connection).who

    def rights(self, connection: str) -> Rights:
        """What may be requested over a connection; nothing once its key has expired."""
        return self._current(connection).rights

    def everywhere(self, connection: str) -> Role:
        """The highest role that a connection has for everything."""
        known = self._known.get(connection)
        if known is None or known.rights.until is not None:
            known = self._current(connection)
        return known.everywhere

    def enter(self, domain: str, address: str, mechanism: str, key: str) -> str | None:
        """The id of a new connection; None for a client that may do nothing at all.

        The socket for publications admits only clients that may look at everything: ZeroMQ selects by prefix, and has
        no safe way to refuse one prefix to one subscriber (docs/promises.md).
        """
        transport, _, publishes = domain.partition(" ")
        address = address.removeprefix("::ffff:")  # IPv4 at a socket for both
        who = introduced(transport, address, mechanism, key)
        rights = self.rights(who.id)
        if rights.role == Role.NONE or (publishes and rights.everywhere < Role.OBSERVE):
            known = self.principal(who.id) if who.id else replace(NOBODY, address=address)
            where = " to publications, which need the right to observe everything" if publishes else ""
            said = f"refused: {known} is not let in{where}"
            self.audit.note(who.account, f"enter {publishes}", lambda: said, logging.WARNING)
            return None
        if self._origins is not None and who.address:
            self._origins.setdefault(who.address, set()).add(who)
            if sum(map(len, self._origins.values())) > _KEPT:
                self._origins = None
        return who.id

    def guest(self, bridge: str, name: str) -> str:
        """The connection of the guest that a bridge speaks for; the bridge's own if none is named.

        Nothing may be requested over it if the bridge has no right to speak for that name.
        """
        if not name:
            return bridge
        if len(name) > _NAME or not name.isprintable():
            return ""
        return on_behalf(from_id(bridge), name).id

    def _current(self, connection: str) -> _Known:
        known = self._look_up(connection)
        until = known.rights.until
        return known if until is None or self._now() < until else _UNKNOWN

    def _look_up(self, connection: str) -> _Known:
        found = self._known.get(connection)
        if found is None:
            if len(self._known) >= _KEPT:
                self._known.clear()
            found = self._known[connection] = self._find_out(connection)
        return found

    def _find_out(self, connection: str) -> _Known:
        name, bridge = guest_of(connection)
        if name:
            behind = self._look_up(bridge)  # also where its key has expired: the guest's rights end with it
            speaks = behind.rights.speaks_for(name)
            rights = policy.of_guest(name, behind.rights, self._access) if speaks else policy.NOTHING
            return _Known(on_behalf(behind.who, name), rights, rights.everywhere)
        who = policy.known_as(from_id(connection), self._access, self._users)
        rights = policy.rights_of(who, self._access, self._users)
        return _Known(who, rights, rights.everywhere)

    def admit(self, connection: str, request: Request, right: Right, scene: Callable[[], Scene]) -> Request:
        """The request as it may be carried out.

        Raises Forbidden, and whatever the scene raises for names that do not exist.
        """
        known, need = self._known.get(connection), right.least
        if known is None or known.rights.until is not None:
            known = self._current(connection)
        if known.everywhere < need.role:
            try:
                request = self._narrowly(connection, known, request, right, scene)
            except Forbidden as error:
                self.refused(connection, type(request).__name__, error)
                raise
        if need.role >= _OPERATE:
            self.audit.note(connection, type(request).__name__, lambda: described(known.who, request))
        return request

    def _narrowly(
        self, connection: str, known: _Known, request: Request, right: Right, scene: Callable[[], Scene]
    ) -> Request:
        """As `admit`, for clients whose rights have limits."""
        if known.rights.role < right.least.role:
            raise Forbidden(_sentence(self.principal(connection), right.least))
        seen = scene()
        request = resolved(request, seen)
        self.check(connection, *needs_of(right, request, seen))
        return request

    def refused(self, connection: str, kind: str, error: Forbidden) -> None:
        """Log a refusal, once for a burst of them."""
        self.audit.note(connection, f"refused {kind}", lambda: f"refused: {error}", logging.WARNING)

    def check(self, connection: str, *needs: Need) -> None:
        """Raise Forbidden for what is not allowed."""
        check(self.principal(connection), self.rights(connection), *needs)


def check(who: Principal, rights: Rights, *needs: Need) -> None:
    """Raise Forbidden for what rights do not allow. Any thread."""
    missing = next((need for need in needs if not rights.allow(need)), None)
    if missing is not None:
        raise Forbidden(_sentence(who, missing))


def _sentence(who: Principal, need: Need) -> str:
    named = {"configuration": need.config, "region": need.region, "register": need.register, "data": need.data}
    what = [f"{kind} {name!r}" for kind, name in named.items() if name not in (None, "*")]
    on = f" on {', '.join(what)}" if what else ""
    topic = "everything" if need.topic == "*" else need.topic or "this"
    return f"{who} has no right to {topic}{on}; it takes the role {need.role.name.lower()} there"
