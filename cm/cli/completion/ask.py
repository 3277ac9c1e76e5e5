# SPDX-License-Identifier: Apache-2.0
"""Questions to the running manager, for completion: one at a time, with a short time-out."""

from __future__ import annotations

from types import TracebackType

import zmq

from cm.client import place
from cm.client.sockets import prepare
from cm.errors import Timeout
from cm.messages.requests import ListConfigs, ReadConfig, Request
from cm.messages.status import ConfigInfo
from cm.wire.encode import decode_reply, encode_request

_PATIENCE = 1000  # ms; a prompt that hangs is worse than one that completes nothing


class Asker:
    """A connection to the manager that options name, made when something is asked. A context manager."""

    def __init__(self, runtime_dir: str | None, connect: str | None, keys: str | None) -> None:
        self._where = connect, runtime_dir, keys
        self._context: zmq.Context[zmq.Socket[bytes]] | None = None
        self._socket: zmq.Socket[bytes] | None = None

    def configs(self) -> tuple[str, ...]:
        """Names of the configurations."""
        return self._config(ListConfigs()).names

    def config(self, name: str = "") -> ConfigInfo:
        """A configuration; the loaded one's if no name is given."""
        return self._config(ReadConfig(config_name=name))

    def _config(self, request: Request) -> ConfigInfo:
        self._connected().send_multipart(encode_request(request))
        if not self._connected().poll(_PATIENCE):
            raise Timeout("no answer")
        reply = decode_reply(self._connected().recv_multipart())
        return reply.body if isinstance(reply.body, ConfigInfo) else ConfigInfo()

    def _connected(self) -> zmq.Socket[bytes]:
        if self._socket is None:
            found = place.find(*self._where)
            self._context = zmq.Context()
            self._socket = prepare(self._context.socket(zmq.REQ), found.keys)
            self._socket.connect(found.endpoints.req)
        return self._socket

    def __enter__(self) -> Asker:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        if self._context is not None:
            self._context.destroy(linger=0)
