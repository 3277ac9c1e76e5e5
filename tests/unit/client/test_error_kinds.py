# SPDX-License-Identifier: Apache-2.0
"""A refusal raises the same kind of error at the client as at the manager."""

from __future__ import annotations

import importlib
import pkgutil

import pytest

import cm.manager
import cm.server
import cm.wire
from cm.client import errors as client
from cm.errors import Busy, CmError, Forbidden, InvalidRequest, NotFound, Timeout
from cm.wire.messages.status import ErrorInfo

KINDS = {
    Busy: client.RequestBusy,
    Forbidden: client.RequestForbidden,
    InvalidRequest: client.RequestInvalid,
    NotFound: client.RequestNotFound,
    Timeout: client.RequestTimeout,
}
OTHERS = {"nothing_loaded", "already_served", "state_in_use"}  # about a state, or a manager that does not start


def refusals() -> list[type[CmError]]:
    """All errors of the packages that answer requests."""
    for package in (cm.manager, cm.server, cm.wire):
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            importlib.import_module(module.name)
    found: list[type[CmError]] = []
    waiting = list(KINDS)
    while waiting:
        for kind in waiting.pop().__subclasses__():
            if kind.__module__.startswith(("cm.manager", "cm.server", "cm.wire")):
                found.append(kind)
            waiting.append(kind)
    return sorted({kind for kind in found if kind.code not in OTHERS}, key=lambda kind: kind.__qualname__)


@pytest.mark.parametrize("kind", refusals(), ids=lambda kind: kind.code)
def test_a_refusal_has_the_same_kind_at_the_client(kind: type[CmError]) -> None:
    wanted = tuple(there for here, there in KINDS.items() if issubclass(kind, here))
    assert isinstance(client.request_error(ErrorInfo(kind.code, "no")), wanted)
