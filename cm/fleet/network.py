# SPDX-License-Identifier: Apache-2.0
"""The zenoh session of a bridge, a client or a router: where it connects, and with which certificate."""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cm.errors import CmError, InvalidRequest

PORT = 7447
LEASE = 10.0  # seconds, zenoh's own
_TRY = 3000  # milliseconds of one try to reach a router
_AGAIN = 1.0  # seconds between two


class NoNetwork(CmError, ConnectionError):
    """The fleet's network cannot be reached, or what is given for it is wrong."""

    code = "no_network"


@dataclass(frozen=True, slots=True)
class Network:
    """`mode`: client, peer or router. `endpoints` as zenoh spells them; `config`: a file of zenoh's settings."""

    mode: str = "client"
    connect: tuple[str, ...] = ()
    listen: tuple[str, ...] = ()
    config: Path | None = None
    lease: float = LEASE  # seconds until a process that stopped answering is told to be gone


def endpoint(text: str) -> str:
    """``host``, ``host:port`` or zenoh's own ``tcp/host:port`` → zenoh's."""
    if "/" in text:
        return text
    host, colon, port = text.rpartition(":")
    if not colon or text.endswith("]"):
        host, port = text, str(PORT)
    if not port.isdecimal() or not host:
        raise InvalidRequest(f"router {text!r}: HOST, HOST:PORT, or zenoh's tcp/HOST:PORT or tls/HOST:PORT is wanted")
    return f"tcp/{host}:{port}"


def from_environment() -> tuple[str, ...]:
    """`$CM_FLEET`: routers between commas."""
    return tuple(endpoint(text) for text in os.environ.get("CM_FLEET", "").split(",") if text)


def zenoh_module() -> Any:
    """The library. Raises NoNetwork where it is not installed."""
    try:
        import zenoh
    except ImportError as error:
        raise NoNetwork(f"a fleet needs eclipse-zenoh: pip install 'fpga-cm[zenoh]' ({error})") from None
    return zenoh


def session(network: Network) -> Any:
    """An open session. Raises NoNetwork."""
    zenoh = zenoh_module()
    try:
        config = zenoh.Config.from_file(str(network.config)) if network.config else zenoh.Config()
        for name, value in _settings(network):
            config.insert_json5(name, json.dumps(value))
        return zenoh.open(config)
    except (zenoh.ZError, OSError) as error:
        raise NoNetwork(f"{_where(network)}: {_said(error)}") from None


def awaited(network: Network, over: threading.Event, say: Callable[[str], None]) -> Any:
    """The same, tried until there is a router, which is said; None once it is over."""
    said = ""
    while not over.is_set():
        try:
            return session(network)
        except NoNetwork as error:
            if str(error) != said:
                say(f"{error}; it is tried again")
            said = str(error)
            over.wait(_AGAIN)
    return None


def _where(network: Network) -> str:
    return ", ".join((*network.connect, *network.listen)) or str(network.config or "zenoh")


def _said(error: Exception) -> str:
    """What zenoh says, without where in its sources."""
    return str(error).split(" at ", maxsplit=1)[0].strip() or type(error).__name__


def _settings(network: Network) -> list[tuple[str, Any]]:
    """What is said here goes over what a file says."""
    found: list[tuple[str, Any]] = []
    if network.config is None:
        found += [("mode", network.mode), ("scouting/multicast/enabled", not network.connect and not network.listen)]
        if network.mode == "client":
            found.append(("connect/timeout_ms", _TRY))
    if network.config is None or network.lease != LEASE:
        found.append(("transport/link/tx/lease", int(network.lease * 1000)))
    if network.connect:
        found.append(("connect/endpoints", list(network.connect)))
    if network.listen:
        found.append(("listen/endpoints", list(network.listen)))
    return found
