# SPDX-License-Identifier: Apache-2.0
"""A thread that waits for samples of several readers and passes them on."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from functools import partial

from cyclonedds.core import GuardCondition, InstanceState, ReadCondition, SampleState, ViewState, WaitSet
from cyclonedds.domain import DomainParticipant
from cyclonedds.sub import DataReader
from cyclonedds.util import duration

from cm.dds.types import Raw
from cm.errors import CmError

_LOG = logging.getLogger("cm.dds")
_MANY = 16  # samples that are taken at a time
_EVER = duration(seconds=3600)
_ANY = SampleState.Any | ViewState.Any | InstanceState.Any


class Dispatcher:
    """Runs from the first reader on until it is closed."""

    def __init__(self, participant: DomainParticipant, name: str) -> None:
        self._waitset = WaitSet(participant)
        self._wake = GuardCondition(participant)
        self._waitset.attach(self._wake)
        self._readers: tuple[tuple[ReadCondition, Callable[[], None]], ...] = ()
        self._closed = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def add(self, reader: DataReader, take: Callable[[Raw], None]) -> None:
        """Pass each sample to `take`; a CmError that it raises is logged."""
        self.watch(reader, lambda: _hand_on(reader, take))

    def watch(self, reader: DataReader, work: Callable[[], None]) -> None:
        """Call `work` whenever something has come; it takes all that is there."""
        condition = ReadCondition(reader, _ANY)
        self._readers = (*self._readers, (condition, work))
        self._waitset.attach(condition)
        if not self._thread.ident:
            self._thread.start()
        self._wake.set(True)  # for what had come before it was attached

    def _run(self) -> None:
        while not self._closed:
            self._waitset.wait(_EVER)
            self._wake.set(False)
            for _, work in self._readers:
                if not self._closed:
                    logged(work)

    def close(self) -> None:
        """End the thread, and wait for it; twice is fine. The readers still belong to their owner."""
        self._closed = True
        self._wake.set(True)
        if self._thread.ident and self._thread is not threading.current_thread():
            self._thread.join()


def _hand_on(reader: DataReader, take: Callable[[Raw], None]) -> None:
    while samples := reader.take(N=_MANY):
        for sample in samples:
            if isinstance(sample, Raw):  # not the notice that a writer has gone
                logged(partial(take, sample))


def logged(work: Callable[[], None]) -> None:
    """A failure with one sample must not end the thread, which serves other readers too."""
    try:
        work()
    except CmError as error:
        _LOG.warning("%s", error)
    except Exception:  # noqa: BLE001 (a defect in one handler)
        _LOG.exception("a sample was not taken")
