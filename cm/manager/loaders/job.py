# SPDX-License-Identifier: Apache-2.0
"""What a loader is given, and its interface."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Protocol

from cm.manager.interfaces import Image
from cm.schema.model import Config, Module, Region

OnBytes = Callable[[int], None]
Start = Callable[[OnBytes], None]  # loads, telling how far it is; returns when the port is done


@dataclass(frozen=True, slots=True)
class Job:
    """An image and where it goes; region and module are None for the whole device."""

    config: Config
    image: Image
    region: Region | None = None
    module: Module | None = None
    overlay: bytes = b""  # by which the module is loaded, for LoaderKind.OVERLAY
    port: str | None = None  # its name, where there are several


class Loader(Protocol):
    """Loads one image."""

    def check(self, job: Job) -> None:
        """Raise what is known beforehand to prevent the job; touches nothing."""

    def prepared(self, job: Job, timeout: float) -> AbstractContextManager[Start]:
        """On entry, all that can be done before the port is touched; gives the function that touches it.

        `timeout` (seconds) is for both. Entering raises what is wrong with files or memory, or StepTimeout if the port
        stays busy: then nothing was loaded. `Start` raises LoadFailed, StepTimeout or DeviceError.
        """

    def forget(self) -> None:
        """The board was lost: drop what belongs to it."""
