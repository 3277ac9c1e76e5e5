# SPDX-License-Identifier: Apache-2.0
"""Requests on a DEALER: numbers by which replies are matched, and the error if none arrives."""

from __future__ import annotations

import itertools
from typing import Any

from cm.client.core.calls import Call
from cm.client.errors import ConnectionLost, NoAnswer
from cm.client.find_manager import deserted
from cm.wire.encode import encode_request
from cm.wire.envelope import GUEST
from cm.wire.messages import requests as rq

CONNECTING = 0.1  # seconds after which it is looked again whether anybody is there, while there is no connection
LOOKS = (  # change nothing
    *(rq.ReadReg, rq.ReadStatus, rq.ReadConfig, rq.ListConfigs, rq.PlanChange, rq.ReadIrq, rq.DescribeData),
    rq.ReadData,
)


class Requests:
    """The requests of one connection; a late reply to one is never taken for the reply to another.

    `guest`: in whose name a bridge makes them; empty for its own.
    """

    def __init__(self, address: str, guest: str = "") -> None:
        self.address = address
        self._numbers = itertools.count(1)
        self._between = (GUEST + guest.encode(), b"") if guest else (b"",)  # the number and the command
        self.envelope = 1 + len(self._between)  # frames of a request that come back before its reply

    def begin(self, call: Call[Any]) -> tuple[bytes, tuple[Any, ...]]:
        """The number of a new request, and the frames that carry it."""
        number = b"%d" % next(self._numbers)
        return number, (number, *self._between, *encode_request(call.request))

    def absent(self) -> NoAnswer | None:
        """The error where the socket itself says that nobody will answer; for as long as there is no connection."""
        why = deserted(self.address)
        return NoAnswer(f"no configuration manager at {self.address}: {why}") if why else None

    def no_answer(self, limit: float | None) -> NoAnswer:
        """Nothing came within `limit` seconds."""
        return NoAnswer(f"no answer from a configuration manager at {self.address} within {limit or 0:g} s")

    def lost(self) -> ConnectionLost:
        """The manager went away."""
        return ConnectionLost(f"the configuration manager at {self.address} went away")
