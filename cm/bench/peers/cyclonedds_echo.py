# SPDX-License-Identifier: Apache-2.0
"""cyclonedds (Python): a sequence of bytes, published there and back.

No postponed annotations here: the IDL types are read from them when the class is made.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cyclonedds.core import InstanceState, Policy, Qos, ReadCondition, SampleState, ViewState, WaitSet
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import sequence, uint8
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

_PATIENCE = 60  # seconds, on a loaded machine


@dataclass
class Frame(IdlStruct, typename="cm.bench.Frame"):
    """One frame."""

    data: sequence[uint8]  # type: ignore[type-arg]


class _Ends:
    def __init__(self, folder: Path, there: str, back: str) -> None:
        prefix = re.sub(r"\W", "_", str(folder))  # all participants in the network's domain 0 see it
        qos = Qos(Policy.Reliability.Reliable(duration(seconds=_PATIENCE)), Policy.History.KeepLast(1))
        self._participant = DomainParticipant()
        self.writer = DataWriter(self._participant, Topic(self._participant, f"{prefix}_{there}", Frame, qos=qos), qos)
        self.reader = DataReader(self._participant, Topic(self._participant, f"{prefix}_{back}", Frame, qos=qos), qos)
        condition = ReadCondition(self.reader, SampleState.NotRead | ViewState.Any | InstanceState.Alive)
        self._condition = condition
        self._waitset = WaitSet(self._participant)
        self._waitset.attach(condition)

    def take(self, seconds: float) -> Any:
        self._waitset.wait(duration(milliseconds=int(seconds * 1000)))
        taken = self.reader.take(N=1)
        return taken[0] if taken else None


class DdsNear(_Ends):
    """This end."""

    def __init__(self, folder: Path, size: int) -> None:
        super().__init__(folder, "there", "back")
        self._frame = Frame(data=b"\x5a" * size)  # type: ignore[arg-type]

    def trip(self) -> Any:
        """There and back."""
        self.writer.write(self._frame)
        while (frame := self.take(_PATIENCE)) is None:
            continue
        return frame

    def close(self) -> None:
        """The participant's end closes its entities."""


def near(folder: Path, size: int) -> DdsNear:
    """This end; returns when the far end answers."""
    ends = DdsNear(folder, size)
    for _ in range(100):
        ends.writer.write(Frame(data=b"?"))  # type: ignore[arg-type]
        if ends.take(0.1) is not None:
            break
    while ends.take(0.2) is not None:
        continue
    return ends


def far(folder: Path, size: int, ready: Callable[[], None]) -> None:  # noqa: ARG001 (any size)
    """The other end."""
    ends = _Ends(folder, "back", "there")
    ready()
    while True:
        frame = ends.take(_PATIENCE)
        if frame is not None:
            ends.writer.write(frame)
