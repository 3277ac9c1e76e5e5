# SPDX-License-Identifier: Apache-2.0
"""What a manager is given, and what an operator may set."""

from __future__ import annotations

from dataclasses import dataclass

from cm.manager.interfaces import DataPlane, Devices, Files, Observer, TimeSource
from cm.manager.state.record import Journal


@dataclass(frozen=True, slots=True)
class Settings:
    """What an operator may set."""

    prefetch_bytes: int = 64 << 20  # DMA memory that images of the loaded configuration may take


@dataclass(frozen=True, slots=True)
class Environment:
    """Everything the manager is given."""

    devices: Devices
    files: Files
    journal: Journal
    data_plane: DataPlane
    time: TimeSource
    observer: Observer
    settings: Settings = Settings()
