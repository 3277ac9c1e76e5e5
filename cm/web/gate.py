# SPDX-License-Identifier: Apache-2.0
"""Who may use the page's server: decided by the token, and by the origin that the browser states.

A foreign page that is open in a browser can make it connect here, from the user's own machine, and a name that such a
page controls can be made to resolve to this machine (DNS rebinding). Neither knows the token. In addition, the Host
has to be an address or a name of this machine, and the Origin of a WebSocket that of our own page.
"""

from __future__ import annotations

import hmac
import ipaddress
import os
import secrets
from collections.abc import Collection
from dataclasses import dataclass
from urllib.parse import urlsplit

from cm.errors import InvalidRequest

_SHORTEST = 16  # characters of a token


@dataclass(frozen=True, slots=True)
class Gate:
    """What a request has to have. `names`: the names of this machine, beside its addresses."""

    token: str
    names: frozenset[str]

    @classmethod
    def of(cls, token: str, names: Collection[str]) -> Gate:
        """With this machine's name, and a new token if none is given.

        Raises InvalidRequest for a token that is too short.
        """
        if token and len(token) < _SHORTEST:
            raise InvalidRequest(f"the token has {len(token)} characters; it must not be guessed: {_SHORTEST} at least")
        known = {"localhost", os.uname().nodename, *names}
        return cls(token or secrets.token_urlsafe(24), frozenset(name.lower() for name in known))

    def knows(self, token: object) -> bool:
        """Whether that is the token."""
        return isinstance(token, str) and hmac.compare_digest(token.encode(), self.token.encode())

    def refuses_host(self, host: str) -> str:
        """Why a request with this Host is refused; empty if it is not."""
        name = _hostname(host)
        if name is None:
            return "the request has no Host, or one that is not an address"
        if name in self.names or _is_address(name):
            return ""
        return f"this machine is not known as {name!r}; if it is, say: cm web --name {name}"

    def refuses_origin(self, origin: str | None, host: str) -> str:
        """Why a page of this origin may not connect; empty if it may. Programs other than browsers send none."""
        if origin is None or urlsplit(origin).netloc.lower() == host.lower():
            return ""
        return f"a page of {origin!r} may not connect here"


def _hostname(host: str) -> str | None:
    try:
        parts = urlsplit(f"//{host}")
        _ = parts.port
    except ValueError:
        return None
    same = parts.netloc == host and not parts.username
    return parts.hostname.lower().rstrip(".") if parts.hostname and same else None


def _is_address(name: str) -> bool:
    """An address is what it says; a name can be made to resolve elsewhere."""
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def is_loopback(host: str) -> bool:
    """Whether what listens there is reached from this machine only."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
