# SPDX-License-Identifier: Apache-2.0
"""Interprets the events of a socket's monitor: the manager has gone, or does not admit us. No sockets here."""

from __future__ import annotations

import zmq

from cm.client.errors import NotAdmitted

EVENTS = (
    zmq.EVENT_DISCONNECTED
    | zmq.EVENT_HANDSHAKE_SUCCEEDED
    | zmq.EVENT_HANDSHAKE_FAILED_AUTH
    | zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL
    | zmq.EVENT_HANDSHAKE_FAILED_NO_DETAIL
)
_ATTEMPTS = 3  # handshakes that fail without a reason, before that is reported


class Handshake:
    """Follows the events of one socket. `keys`: whether we have some."""

    def __init__(self, address: str, keys: bool) -> None:
        self._address = address
        self._keys = keys
        self._failures = 0
        self.refused: NotAdmitted | None = None  # the refusal, once it is certain; the socket does not connect any more
        self.suspected: NotAdmitted | None = None  # reported at a time-out, as the socket keeps trying
        self.up = False  # whether there is a connection now
        self.lost = False  # whether an established connection has ended since this was set to False

    def take(self, event: int, value: int) -> None:
        """An event and its value."""
        if event == zmq.EVENT_HANDSHAKE_SUCCEEDED:
            self._failures = 0
            self.suspected = None
            self.up = True
        elif event == zmq.EVENT_HANDSHAKE_FAILED_AUTH:
            self.refused = NotAdmitted(self._unknown())
        elif event == zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL:
            if value == zmq.PROTOCOL_ERROR_ZMTP_MECHANISM_MISMATCH:
                self.refused = NotAdmitted(self._mismatch())
        elif event == zmq.EVENT_HANDSHAKE_FAILED_NO_DETAIL:
            # this happens if the manager's key is another, or if it is not up yet behind a forwarder
            self._failures += 1
            if self._keys and self._failures >= _ATTEMPTS:
                self.suspected = NotAdmitted(
                    f"every handshake with the manager at {self._address} is ended: it has another key than the key "
                    "file's 'server-public', takes no more connections, or is not up behind what forwards its port"
                )
        elif not self._failures:
            self.lost, self.up = True, False

    def _unknown(self) -> str:
        if self._keys:
            return (
                f"the manager at {self._address} does not know this key, or it has expired or has no role: its "
                "administrator puts NAME.pub into authorized_keys.d"
            )
        return (
            f"the manager at {self._address} gives this user no role: its administrator does, under 'access' in cm.yaml"
        )

    def _mismatch(self) -> str:
        if self._keys:
            return f"the manager at {self._address} has no keys (--insecure): connect without keys"
        return f"the manager at {self._address} wants keys: connect(keys=…), --keys FILE, as 'cm keygen' made them"
