# SPDX-License-Identifier: Apache-2.0
"""The zenoh session of a bridge, a client or a router: where it connects, and with which certificate."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from cm.errors import CmError, InvalidRequest, NotInstalled
from cm.extras import installing

PORT = 7447
LEASE = 10.0  # seconds, zenoh's own
_PROTOCOLS = ("tcp", "tls", "quic", "udp", "ws", "unixsock-stream", "unixpipe", "serial", "vsock")
_LINK = {  # of keep-alives two are sent within a lease; a queue that has stood for 5 s ends its link
    "transport/link/tx/keep_alive": 2,
    "transport/link/tx/queue/congestion_control/block/wait_before_close": 5_000_000,
}
_TRY = 3000  # milliseconds of one try to reach a router


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
    lease: float = LEASE  # seconds until a process that has stopped answering counts as gone
    store: str = ""  # "keeper", etcd's URLs, or a file; empty: what the environment or `config` says


def endpoint(text: str) -> str:
    """``host``, ``host:port`` or zenoh's own ``tcp/host:port`` → zenoh's."""
    if "/" in text:
        if text.partition("/")[0] not in _PROTOCOLS:
            raise InvalidRequest(f"router {text!r}: zenoh has {', '.join(_PROTOCOLS)}, as in tls/HOST:PORT")
        return text
    host, colon, port = text.rpartition(":")
    if not colon or text.endswith("]"):
        host, port = text, str(PORT)
    if not host or not port.isdecimal() or not 0 < int(port) < 1 << 16:
        raise InvalidRequest(f"router {text!r}: HOST, HOST:PORT, or zenoh's tcp/HOST:PORT or tls/HOST:PORT is wanted")
    return f"tcp/{host}:{port}"


def from_environment() -> tuple[str, ...]:
    """`$CM_FLEET`: routers between commas."""
    return tuple(endpoint(text) for text in os.environ.get("CM_FLEET", "").split(",") if text)


def zenoh_module() -> Any:
    """The library. Raises NotInstalled."""
    try:
        import zenoh
    except ImportError as error:
        raise NotInstalled(f"a fleet needs eclipse-zenoh: {installing('zenoh')} ({error})") from None
    return zenoh


def in_loop(what: Callable[..., object]) -> Callable[..., None]:
    """The same in the loop that runs here, to be called in any thread; not done where that has ended."""
    loop = asyncio.get_running_loop()

    def call(*arguments: Any) -> None:
        with contextlib.suppress(RuntimeError):
            loop.call_soon_threadsafe(what, *arguments)

    return call


def session(network: Network) -> Any:
    """An open session. Raises NoNetwork."""
    zenoh = zenoh_module()
    config = settings_of(network.config) if network.config else zenoh.Config()
    try:
        for name, value in _settings(network).items():
            config.insert_json5(name, json.dumps(value))
        return zenoh.open(config)
    except (zenoh.ZError, OSError) as error:
        why = said(error)
        if "timeout" in why.lower():
            asked = tuple(json.loads(config.get_json("connect/endpoints")) or ()) if not network.listen else ()
            raise NoNetwork(_unreachable(asked)) from None
        where = ", ".join((*network.connect, *network.listen)) or str(network.config or "zenoh")
        raise NoNetwork(f"{where}: {why}") from None


def closed(session: Any) -> None:
    """Close it; zenoh raises that it could not say farewell where the network is gone."""
    with contextlib.suppress(zenoh_module().ZError):
        session.close()


def is_alive(session: Any, key: str) -> bool:
    """Whether somebody has a token of that name."""
    return any(reply.ok is not None for reply in session.liveliness().get(key, timeout=2.0))


def hears(network: Network, keys: Iterable[str], timeout: float) -> bool | None:
    """Whether who offers these keys answers a member that has just come; None if there is no network to ask it over.

    A session is never given its own queries back, so this is one of its own, for a moment.
    """
    try:
        opened = session(replace(network, listen=(), mode="client"))
    except NoNetwork:
        return None
    try:
        found = [list(opened.get(key, timeout=timeout)) for key in keys]
        return all(any(r.ok is not None or bytes(r.err.payload) != b"Timeout" for r in replies) for replies in found)
    finally:
        closed(opened)


def settings_of(path: Path) -> Any:
    """zenoh's settings in a file. Raises NoNetwork."""
    zenoh = zenoh_module()
    try:
        path.open("rb").close()
        return zenoh.Config.from_file(str(path))
    except OSError as error:
        raise NoNetwork(f"{path}: {error.strerror}: `cm fleet keys` writes such files") from None
    except zenoh.ZError as error:
        raise NoNetwork(f"{path} is no file of zenoh's settings (JSON5): {said(error)}") from None


def metadata_of(config: Path | None, what: str) -> str:
    """One of the words that ``cm fleet keys`` wrote into a file of settings; empty where it has none."""
    said = (json.loads(settings_of(config).get_json("metadata")) or {}).get(what) if config else ""
    return said if isinstance(said, str) else ""


def _unreachable(routers: tuple[str, ...]) -> str:
    """For each of these causes, zenoh only says that time is over."""
    if not routers:
        return "nobody answers on this network: name the fleet's router (--router HOST, or $CM_FLEET)"
    tls = any(router.startswith(("tls/", "quic/")) for router in routers)
    what = "there is none, or one of us does not take the other's certificate" if tls else "is it there?"
    return f"no router answers at {', '.join(routers)}: {what}"


def said(error: Exception) -> str:
    """zenoh's message, without the place in its sources."""
    return " ".join(str(error).split(" at ", maxsplit=1)[0].split()) or type(error).__name__


def _settings(network: Network) -> dict[str, Any]:
    """The settings; those given here override those of the file."""
    found: dict[str, Any] = {}
    if network.config is None:
        multicast = not network.connect and not network.listen
        found = {"mode": network.mode, "scouting/multicast/enabled": multicast}
        if network.mode == "client":
            found["connect/timeout_ms"] = _TRY
        found |= _LINK
    if network.config is None or network.lease != LEASE:
        found["transport/link/tx/lease"] = int(network.lease * 1000)
    for name, endpoints in (("connect", network.connect), ("listen", network.listen)):
        if endpoints:
            found[f"{name}/endpoints"] = list(endpoints)
    return found
