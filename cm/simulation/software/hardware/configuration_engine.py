# SPDX-License-Identifier: Apache-2.0
"""The configuration engine behind ICAP and the fpga_manager: takes words at a rate, changes the fabric."""

from __future__ import annotations

import errno
import time
from collections.abc import Callable

from cm.formats.bitstream.idcodes import Device
from cm.frozen import dataclass
from cm.loop import Loop
from cm.simulation.software.errors import NodeError
from cm.simulation.software.faults import Faults
from cm.simulation.software.hardware.configuration_memory import ConfigMemory
from cm.simulation.software.hardware.configuration_port import ConfigPort, PortError
from cm.simulation.software.hardware.fabric import Fabric
from cm.simulation.software.transport import protocol

Through = Callable[[memoryview, bool], memoryview]  # words on their way, and whether the port signals an error
_STEP, _LONGEST = 0.001, 0.02  # seconds of simulated time between two looks at the port:
_PIECE = 16384  # longer than the shortest for a slow port, which takes so many bytes meanwhile


@dataclass(frozen=True, slots=True)
class LoadResult:
    """How a load ended; times are CLOCK_MONOTONIC in ns."""

    length: int
    started_ns: int
    finished_ns: int
    status: int
    errors: int


class ConfigurationEngine:
    """One load at a time, in steps of simulated time; other nodes are served between them."""

    def __init__(
        self, loop: Loop, fabric: Fabric, memory: ConfigMemory, faults: Faults, device: Device, rate: float
    ) -> None:
        self._loop, self._fabric, self._memory, self._faults = loop, fabric, memory, faults
        self._port = ConfigPort(device)
        self.rate = rate
        self.state = protocol.STATE_IDLE
        self.errors = 0
        self.total = 0
        self.loads = 0
        self.reads = 0  # of them
        self._done = 0
        self._run: _Run | None = None
        self._reading = False

    @property
    def busy(self) -> bool:
        """Whether a load or read is under way."""
        return self._run is not None or self._reading

    @property
    def done(self) -> int:
        """Bytes of the load or read that the port has taken."""
        return self._done if self._run is None else self._run.done

    def start(
        self,
        data: memoryview,
        finished: Callable[[LoadResult], None],
        full: bool = False,
        rate: float | None = None,
        asked_ns: int | None = None,
        through: Through | None = None,
    ) -> None:
        """Load `data`, words as in memory (little-endian bus); `finished` is called at the end (EBUSY).

        `data` is read as it goes. `asked_ns` is when the request arrived (default: now): our own work before the
        first word does not count, since a DMA engine begins at once. `through`: a function that the words pass
        through before they arrive.
        """
        self._begin(len(data))
        self._memory.begin(data)
        started_ns = asked_ns or time.monotonic_ns()
        self._run = _Run(data, started_ns, finished, full, self.rate if rate is None else rate, through)
        self._loop.call_soon(self._step)

    def read(
        self,
        request: memoryview,
        reply: memoryview,
        closing: memoryview,
        finished: Callable[[LoadResult], None],
        asked_ns: int,
    ) -> None:
        """Write words, read words into `reply`, and write words; `finished` is called at the end (EBUSY).

        `asked_ns` as for `start`.
        """
        self._begin(len(reply))
        self._reading = True
        seconds = (len(request) + len(reply) + len(closing)) / self.rate if self.rate > 0 else 0.0

        def begin() -> None:
            """The work is done while the words are on their way."""
            end(self._answer(request, reply, closing))

        def end(status: int) -> None:
            left = asked_ns / 1e9 + seconds - time.monotonic()
            if left >= 2 * _STEP:  # the loop's clock is too coarse for the last step
                self._loop.call_later(left - 1.5 * _STEP, lambda: end(status))
                return
            time.sleep(max(left, 0.0))
            self._reading = False
            self.reads += 1
            self._ended(status, protocol.ERR_TIMEOUT if status else 0)
            finished(LoadResult(self._done, asked_ns, time.monotonic_ns(), status, self.errors))

        self._loop.call_soon(begin)

    def _answer(self, request: memoryview, reply: memoryview, closing: memoryview) -> int:
        """What the port does for a read; 0, or an errno's negative."""
        port = self._port
        port.feed(request)
        asked, hangs = port.asked, self._faults.take("icap_hang")
        if asked is not None and not hangs:
            data = self._memory.frames.read(*asked)[: len(reply)]
            reply[: len(data)] = data
            self._done = len(data)
        port.feed(closing)
        return 0 if self._done == len(reply) and port.complete else -errno.ETIMEDOUT

    def _begin(self, total: int) -> None:
        if self.busy:
            raise NodeError(errno.EBUSY, "the port is in use")
        self.state, self.errors, self._done, self.total = protocol.STATE_LOADING, 0, 0, total
        self._port.reset()

    def _ended(self, status: int, errors: int) -> None:
        self.loads += 1
        self.errors = errors
        self.state = protocol.STATE_ERROR if status else protocol.STATE_IDLE

    def _step(self) -> None:
        run = self._run
        if run is None:
            return
        if self._faults.take("icap_hang"):
            # The words go nowhere; the driver gives up when the port should long have been done.
            self._loop.call_later(run.seconds_left + 0.1, lambda: self._finish(-errno.ETIMEDOUT, protocol.ERR_TIMEOUT))
            return
        stall = self._faults.take("icap_stall")
        self._feed(run, stall.value if stall else self.total)
        done = run.done
        if stall and done < self.total:
            self._loop.call_later(_STEP, self._step)
        elif done < self.total:
            self._wait(run)
        else:
            self._finish(*self._verdict())

    def _feed(self, run: _Run, most: int) -> None:
        """Work on the words that are due before the next step, as a port does while the clock runs."""
        now = time.monotonic()
        target = min(run.bytes_at(now + run.step + run.took), most // 4 * 4)
        if target > run.fed:
            taken = words = run.data[run.fed : target]
            if run.through is not None:
                words = run.through(words, bool(self._port.errors))
            writes = self._port.feed(words)
            run.fed = target
            self._memory.apply(writes, run.full, taken)
            run.took = time.monotonic() - now

    def _wait(self, run: _Run) -> None:
        """Wait until the next step; the loop's own clock has milliseconds, which is too coarse for the last step."""
        left = run.seconds_left
        if left < _STEP:
            time.sleep(max(left, 0.0))
            self._loop.call_soon(self._step)
        else:
            self._loop.call_later(min(run.step, left - _STEP / 2), self._step)

    def _verdict(self) -> tuple[int, int]:
        port = self._port
        if self._faults.take("icap_crc"):
            return -errno.EILSEQ, protocol.ERR_CRC
        if self._faults.take("icap_id"):
            return -errno.ENODEV, protocol.ERR_ID
        if port.errors & PortError.IDCODE:
            return -errno.ENODEV, protocol.ERR_ID
        if port.errors & PortError.CRC:
            return -errno.EILSEQ, protocol.ERR_CRC
        if port.errors & PortError.PACKET:
            return -errno.EIO, 0
        if not port.synced and not port.sections:
            return -errno.EIO, protocol.ERR_NOSYNC
        if not port.complete:
            return -errno.ETIMEDOUT, protocol.ERR_TIMEOUT
        return 0, 0

    def _finish(self, status: int, errors: int) -> None:
        run, self._run = self._run, None
        if run is None:
            return
        self._done = run.done
        self._ended(status, errors)
        if run.full and status == 0:
            self._fabric.reset()
        if run.through is not None:
            run.through(run.data[:0], bool(errors))
        sound = run.fed if self._port.sound is None else 4 * self._port.sound
        self._memory.settle(status == 0, sound, self._port.started)
        run.finished(LoadResult(self._done, run.started_ns, time.monotonic_ns(), status, errors))


class _Run:
    """One load: its bytes, and when they are due at the port."""

    def __init__(
        self, data: memoryview, started_ns: int, finished: Callable[[LoadResult], None], full: bool, rate: float,
        through: Through | None,
    ) -> None:  # fmt: skip
        self.through = through
        self.data = data
        self.fed = 0  # bytes worked on
        self.took = 0.0  # seconds of work in the last step, which come before the next one
        self.finished = finished
        self.full = full
        self.started_ns = started_ns
        self._rate = rate
        self.step = min(max(_STEP, _PIECE / rate), _LONGEST) if rate > 0 else _STEP

    def bytes_at(self, now: float) -> int:
        """Bytes that the port has taken by a time of `time.monotonic()`, whole words."""
        if self._rate <= 0:
            return len(self.data)
        return min(len(self.data), int((now - self.started_ns / 1e9) * self._rate / 4) * 4)

    @property
    def done(self) -> int:
        """Bytes that the port has taken now."""
        return min(self.fed, self.bytes_at(time.monotonic()))

    @property
    def seconds_left(self) -> float:
        """Until the last word."""
        if self._rate <= 0:
            return 0.0
        return self.started_ns / 1e9 + len(self.data) / self._rate - time.monotonic()
