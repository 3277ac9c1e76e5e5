# SPDX-License-Identifier: Apache-2.0
"""Errors of the simulator itself, and the one way in which a node refuses a request."""

from __future__ import annotations

import errno
import os
from typing import ClassVar

from cm.errors import CmError


class SimError(CmError):
    """The simulated board could not be started, reached or controlled; the sentence says why."""

    code: ClassVar[str] = "simulator"


class NodeError(OSError):
    """A request to a node fails with this errno; the client sees it as its system call's error."""

    said: ClassVar[bool] = False  # whether the sentence travels with the errno; system calls have no room for one

    def __init__(self, number: int, why: str = "") -> None:
        super().__init__(number, why or os.strerror(number))

    @property
    def number(self) -> int:
        """The positive errno."""
        return self.errno or errno.EIO


class Refused(NodeError):
    """What the simulator's own control refuses, with a sentence for the client."""

    said: ClassVar[bool] = True
