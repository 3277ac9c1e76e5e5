# SPDX-License-Identifier: Apache-2.0
"""The zenoh session of a node, as rmw_zenoh opens its own."""

from __future__ import annotations

import json
import logging
import os
from collections.abc import Mapping
from typing import Any

import zenoh

from cm.errors import InvalidRequest
from cm.networks.fleet.zenoh_session import PORT, endpoint, said

_LOG = logging.getLogger("cm.rmw_zenoh")
_FILE, _OVERRIDE = "ZENOH_SESSION_CONFIG_URI", "ZENOH_CONFIG_OVERRIDE"  # rmw_zenoh's own
_TRY = 3000  # milliseconds for trying to reach a router that was named
# Where rmw_zenoh differs from zenoh's defaults: no search by multicast; a local router knows the others.
USUAL: Mapping[str, Any] = {
    "mode": "peer",
    "connect/endpoints": [f"tcp/localhost:{PORT}"],
    "connect/exit_on_failure": {"router": False, "peer": False, "client": True},
    "connect/timeout_ms": {"router": -1, "peer": -1, "client": _TRY},
    "listen/endpoints": ["tcp/localhost:0"],
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": True,
    "timestamping/enabled": True,  # latched messages are told apart by it
    "queries_default_timeout": 600_000,
    "transport/link/tx/queue/congestion_control/drop/max_wait_before_drop_fragments": 50_000,  # microseconds
}


def opened(router: str = "") -> Any:
    """Open a session.

    `router`: go through that one, instead of through the local one and direct connections to the others.
    `ZENOH_SESSION_CONFIG_URI` and `ZENOH_CONFIG_OVERRIDE` count as they do for rmw_zenoh. Raises InvalidRequest.
    """
    try:
        session = zenoh.open(_config(router))
    except (zenoh.ZError, OSError) as error:
        raise InvalidRequest(f"zenoh does not start{f' by {router}' if router else ''}: {said(error)}") from None
    if not session.info.routers_zid():
        _LOG.warning("no zenoh router is reached yet; until then other nodes do not see this one")
    return session


def _config(router: str) -> Any:
    """The file's settings or the defaults, then those of the override, then those asked for here."""
    path = os.environ.get(_FILE, "")
    config = zenoh.Config.from_file(path) if path else zenoh.Config()
    settings = {} if path else {name: json.dumps(value) for name, value in USUAL.items()}
    for pair in filter(None, os.environ.get(_OVERRIDE, "").split(";")):
        name, equals, text = pair.partition("=")
        if not equals:
            raise InvalidRequest(f"{_OVERRIDE}: {pair!r} is not KEY=VALUE")
        settings[name.strip()] = text
    if router:
        settings |= {"mode": '"client"', "connect/endpoints": json.dumps([endpoint(router)]), "listen/endpoints": "[]"}
    for name, text in settings.items():
        try:
            config.insert_json5(name, text)
        except zenoh.ZError as error:
            raise InvalidRequest(f"zenoh has no setting {name} = {text} ({said(error)})") from None
    return config
