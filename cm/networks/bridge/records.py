# SPDX-License-Identifier: Apache-2.0
"""What a bridge passes on, as frozen data. Stamps are nanoseconds since the epoch, by the board's clock."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from cm.schema.pictures import CameraInfo
from cm.wire.messages.status import ConfigInfo, InterruptInfo, Irq, ModeInfo, RegisterInfo, RegValues, Status


@dataclass(frozen=True, slots=True)
class Identity:
    """Which board it is, and which run of its manager: `started_ns` changes with each restart."""

    name: str
    version: str = ""
    started_ns: int = 0


@dataclass(frozen=True, slots=True)
class Caller:
    """In whose name a request is made: the policy's `guest` (empty: the bridge itself), and its leases' ids."""

    guest: str = ""
    lease: str = ""


@dataclass(frozen=True, slots=True)
class StatusRecord:
    """A status, whole."""

    board: Identity
    stamp_ns: int
    status: Status


@dataclass(frozen=True, slots=True)
class StreamFormat:
    """A stream in the mode that runs, and what its frames are. `encoding` is empty if they are not pictures."""

    name: str
    writes: bool  # towards the hardware
    shape: tuple[int, ...]
    dtype: str
    encoding: str
    frame_id: str
    camera_info: CameraInfo | None = None
    rate: float = 0.0  # frames per second that the source gives; 0: not known


@dataclass(frozen=True, slots=True)
class ConfigRecord:
    """The configuration and mode that run, and what can be named in them; empty while nothing is loaded."""

    board: Identity
    stamp_ns: int
    config: ConfigInfo
    configs: tuple[str, ...]  # that can be loaded
    streams: tuple[StreamFormat, ...] = ()

    @property
    def modes(self) -> tuple[ModeInfo, ...]:
        """All modes of the configuration."""
        return self.config.modes

    @property
    def registers(self) -> tuple[RegisterInfo, ...]:
        """The registers that the mode has."""
        mode = self.config.mode
        return tuple(r for r in self.config.registers if not r.modes or mode in r.modes)

    @property
    def interrupts(self) -> tuple[InterruptInfo, ...]:
        """The interrupts of the configuration."""
        return self.config.interrupts

    def stream(self, name: str) -> StreamFormat | None:
        """The stream of that name, if the mode has one."""
        return next((stream for stream in self.streams if stream.name == name), None)


@dataclass(frozen=True, slots=True)
class RegistersRecord:
    """Registers that any client wrote, with their new values; the stamp is when the bridge learned of it."""

    board: Identity
    stamp_ns: int
    registers: RegValues


@dataclass(frozen=True, slots=True)
class InterruptRecord:
    """An interrupt that came."""

    board: Identity
    stamp_ns: int
    irq: Irq


@dataclass(frozen=True, slots=True)
class FrameRecord:
    """A frame in place: `data` is read-only memory of the manager, valid until the call that passes it returns.

    `height`, `width` and `step` (bytes from row to row) are 0 if `encoding` is empty.
    """

    board: str
    stream: str
    stamp_ns: int
    sequence: int
    frame_id: str
    encoding: str
    height: int
    width: int
    step: int
    data: npt.NDArray[Any]
    mode: str = ""
    generation: int = 0

    @property
    def shape(self) -> tuple[int, ...]:
        """Of the array."""
        return tuple(int(length) for length in self.data.shape)

    @property
    def dtype(self) -> str:
        """Of the elements, a numpy name."""
        return str(np.dtype(self.data.dtype).name)
