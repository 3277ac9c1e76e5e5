# SPDX-License-Identifier: Apache-2.0
"""The node's services: requests to the manager; refusals are answers too, and some may wait for changes of mode."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from cm.errors import Busy, CmError
from cm.networks.bridge.commands import Commands
from cm.networks.bridge.records import Caller
from cm.networks.ros import messages
from cm.networks.ros.transport import Values

Answer = Callable[[dict[str, Any]], Values]


class Waiting:
    """How many requests may wait for changes of mode: `most`, fewer than the middleware has threads.

    A node whose threads all wait could not even be told to cancel.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._free = threading.BoundedSemaphore(most)

    @contextmanager
    def one(self) -> Iterator[None]:
        """Within it a request may take as long as a change does. Raises Busy where as many wait as may."""
        if not self._free.acquire(blocking=False):
            raise Busy(f"{self._most} requests wait for changes of mode at this node already: ask again later")
        try:
            yield
        finally:
            self._free.release()


class Services:
    """Handlers by the name of the service; `guest`: in whose name the manager is asked."""

    def __init__(self, commands: Commands, waiting: Waiting, guest: str = "") -> None:
        self._commands = commands
        self._waiting = waiting
        self._guest = guest

    def all(self) -> Mapping[str, tuple[str, Answer]]:
        """Each service's type, and what answers it."""
        return {
            "set_mode": ("cm_interfaces/srv/SetMode", refusals_told(self.set_mode)),
            "load_config": ("cm_interfaces/srv/LoadConfig", refusals_told(self.load_config)),
            "read_registers": ("cm_interfaces/srv/ReadRegisters", refusals_told(self.read_registers)),
            "write_registers": ("cm_interfaces/srv/WriteRegisters", refusals_told(self.write_registers)),
            "plan": ("cm_interfaces/srv/Plan", refusals_told(self.plan)),
        }

    def caller(self, request: Mapping[str, Any]) -> Caller:
        return Caller(self._guest, request.get("lease", ""))

    def set_mode(self, request: dict[str, Any]) -> Values:
        if not request["mode"]:
            return refusal("invalid_request", "name a mode; load_config goes to the default mode of a configuration")
        with self._waiting.one():
            return {"seconds": self._commands.change(self.caller(request), mode=request["mode"])}

    def load_config(self, request: dict[str, Any]) -> Values:
        config, mode, force = request["config_name"], request["mode"], request["force"]
        with self._waiting.one():
            return {"seconds": self._commands.change(self.caller(request), config, mode, force=force)}

    def read_registers(self, request: dict[str, Any]) -> Values:
        values = self._commands.read_registers(self.caller(request), *request["names"])
        return {"bank": messages.bank(values, time.time_ns())}

    def write_registers(self, request: dict[str, Any]) -> Values:
        writes = {write["name"]: write["value_name"] or write["value"] for write in request["writes"]}
        if len(writes) < len(request["writes"]):
            return refusal("invalid_request", "a register is named twice")
        masks = {write["name"]: write["mask"] for write in request["writes"] if write["use_mask"]}
        values = self._commands.write_registers(self.caller(request), writes, masks)
        return {"bank": messages.bank(values, time.time_ns())}

    def plan(self, request: dict[str, Any]) -> Values:
        return messages.plan(self._commands.plan(self.caller(request), request["config_name"], request["mode"]))


def refusal(code: str, message: str) -> Values:
    return {"success": False, "code": code, "message": message}


def refusals_told(answer: Answer) -> Answer:
    """Wraps `answer`: its reply says success, or has the manager's code and sentence."""

    def told(request: dict[str, Any]) -> Values:
        try:
            return {"success": True, **answer(request)}
        except CmError as error:
            return refusal(error.code, str(error))

    return told
