# SPDX-License-Identifier: Apache-2.0
"""What a loader is given, and what it has to do."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from cm.manager.ports import Image
from cm.schema.model import Config, Module, Region

OnBytes = Callable[[int], None]


@dataclass(frozen=True, slots=True)
class Job:
    """An image and where it goes; region and module are None for the whole device."""

    config: Config
    image: Image
    region: Region | None = None
    module: Module | None = None
    overlay: bytes = b""  # by which the module is loaded, for LoaderKind.OVERLAY

    @property
    def port(self) -> str | None:
        """The name of the port, where there are several."""
        return self.region.loader_name if self.region else None


class Loader(Protocol):
    """Loads one image. Returns when the port is done; raises LoadFailed, StepTimeout or DeviceError."""

    def check(self, job: Job) -> None:
        """Raise what is known beforehand to stand against the job; touches nothing."""

    def load(self, job: Job, timeout: float, on_bytes: OnBytes) -> None:
        """Do the job, telling `on_bytes` how far it is."""

    def forget(self) -> None:
        """The board was lost: drop what belongs to it."""
