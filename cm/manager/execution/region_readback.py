# SPDX-License-Identifier: Apache-2.0
"""A region's frames read back, a slice at a time, and compared with what was loaded.

A slice takes the port for a millisecond at most: between two of them a change gets its turn.
"""

from __future__ import annotations

import contextlib
import functools
import itertools
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from cm.errors import Busy
from cm.frozen import dataclass
from cm.manager.errors import NoReadback, RegionBusy, StepTimeout, UnknownRegion, hint
from cm.manager.inputs import Image
from cm.manager.loaders import resolved
from cm.manager.state.board_state import BoardState, RegionPhase
from cm.manager.state.journal import ManagerState
from cm.schema.model import Config, LoaderKind, Module, Region
from cm.wire.messages.status import FrameError, RegionCheck, RegionMap

if TYPE_CHECKING:
    from cm.manager.interfaces import ConfigPort, Devices, Files, FrameSlice, LoadedFrames, PortBuffer, WrongFrame

SLICE_SECONDS = 0.001  # that a slice may keep the port from a change
_SLOWEST = 100e6  # bytes per second of a port whose clock the driver does not know: a Zynq's PCAP has 145e6
_LINE = 64  # bytes of a cache line, or a multiple of them
_PATIENCE = 2.0  # seconds until a read counts as hung
_LISTED, _BITS = 256, 64  # of a result: frames, and bits of each
_cookies = itertools.count(1 << 32)  # apart from those of loads


@dataclass(frozen=True, slots=True)
class Checked:
    """A region that can be read back, and what was loaded into it."""

    config: Config
    mode: str
    region: Region
    module: Module
    image: Image
    frames: LoadedFrames


def checked_region(name: str, state: ManagerState, devices: Devices, files: Files) -> Checked:
    """What a region holds, and how it is compared; reads its bitstream. Any thread.

    Raises NotFound, RegionBusy where nothing is known of its content, NoReadback where its port cannot be read, and
    what is wrong with the file.
    """
    board, (config, mode) = state.board, _loaded(name, state)
    config = resolved(config, (), devices)[0]
    module = _module(name, board, config)
    region = config.regions[name]
    if region.loader is not LoaderKind.ICAP:
        raise NoReadback(f"region {name} is loaded by {region.loader.value}, which cannot read: loader: icap can")
    if not devices.icap(region.loader_name).info.readable:
        raise NoReadback(
            f"region {name}: its configuration port can be written but not read (no CM_ICAP_CAP_READ): the design's "
            "port, its second DMA channel or this driver has no way back"
        )
    image = _image(config, module, board, files)
    return Checked(config, mode, region, module, image, files.loaded_frames(image))


def loaded_map(name: str, state: ManagerState, files: Files) -> RegionMap:
    """What was loaded into a region, counted. Raises as `checked_region` does, but needs no port that can be read."""
    config, _ = _loaded(name, state)
    module = _module(name, state.board, config)
    device, columns = files.columns(_image(config, module, state.board, files))
    return RegionMap(name, module.name, device, config.name, tuple(columns))


def _loaded(name: str, state: ManagerState) -> tuple[Config, str]:
    """The loaded configuration, which has the region, and its mode."""
    config, mode = state.loaded_config(), state.board.mode
    if config is None or mode is None:
        why = state.taken and f"; {state.taken}"
        raise RegionBusy(f"region {name!r}: nothing is loaded that could be compared{why}")
    if name not in config.regions:
        raise UnknownRegion(f"configuration {config.name!r} has no region {name!r}{hint(name, config.regions)}")
    return config, mode


def _image(config: Config, module: Module, board: BoardState, files: Files) -> Image:
    image = files.image(config, module)
    if image.sha256 != board.region(module.region).sha256:
        raise NoReadback(
            f"region {module.region}: {image.path} is not what was loaded any more; load it, or restore the file"
        )
    return image


def _module(name: str, board: BoardState, config: Config) -> Module:
    held = board.region(name)
    module = config.modules.get(held.module or "")
    if held.phase is not RegionPhase.READY or module is None:
        raise RegionBusy(f"region {name} is {held.phase.value}: nothing is known of what it holds")
    return module


class Reader:
    """Two buffers of a port, for slices one after the other: one is compared while the port fills the other."""

    def __init__(self, port: ConfigPort) -> None:
        self._port = port
        self._buffers: list[PortBuffer] = []  # that which is filled next comes first
        self._last: Callable[[], Sequence[WrongFrame]] = tuple  # compares the slice that was read last

    def most_frames(self, frame_bytes: int) -> int:
        """As many as take the port a slice's time, with what goes before and after them."""
        info = self._port.info
        rate = 4.0 * info.clock_hz or _SLOWEST
        return max(1, min(int(SLICE_SECONDS * rate), info.max_length) // frame_bytes - 3)

    def read(self, part: FrameSlice) -> Sequence[WrongFrame]:
        """Read a slice; returns what is wrong in the one before it. Raises DeviceError, StepTimeout, NoReadback."""
        asking, reply = len(part.request), _line(len(part.request))
        closing = _line(reply + part.reply_length)
        end = closing + len(part.closing)
        buffer = self._room(end)
        view = buffer.memoryview()
        buffer.sync_begin(write=True)
        view[:asking], view[closing:end] = part.request, part.closing
        buffer.sync_end(write=True)
        cookie, parts = next(_cookies), (slice(0, asking), slice(reply, reply + part.reply_length), slice(closing, end))
        self._port.read(buffer, *parts, cookie=cookie)
        wrong = self.rest()
        self._await(cookie, part.reply_length)
        self._last = functools.partial(_judged, part, buffer, view[reply : reply + part.reply_length])
        return wrong

    def rest(self) -> Sequence[WrongFrame]:
        """What is wrong in the slice that was read last."""
        last, self._last = self._last, tuple
        return last()

    def _room(self, length: int) -> PortBuffer:
        if len(self._buffers) == 2:
            self._buffers.reverse()
        if len(self._buffers) < 2 or self._buffers[0].length < length:
            for buffer in self._buffers[:1] if len(self._buffers) == 2 else ():
                buffer.close()
            self._buffers = [self._port.allocate(length), *self._buffers[-1:]]
        return self._buffers[0]

    def _await(self, cookie: int, length: int) -> None:
        while True:
            try:
                completion = self._port.wait(_PATIENCE)
            except TimeoutError:
                raise StepTimeout(f"the port did not answer a read within {_PATIENCE:.0f} s") from None
            if completion.cookie == cookie:
                break
        if completion.status or completion.length != length:
            raise NoReadback(f"the port gave {completion.length} of {length} bytes: {completion.reason or 'too few'}")

    def close(self) -> None:
        """Give the buffers back; one that a hung read still holds goes with the port's file."""
        buffers, self._buffers, self._last = self._buffers, [], tuple
        for buffer in buffers:
            with contextlib.suppress(Busy):
                buffer.close()


def _line(length: int) -> int:
    """The next place on a cache line of its own, as memory wants it that has to be synchronised."""
    return -(-length // _LINE) * _LINE


def _judged(part: FrameSlice, buffer: PortBuffer, reply: memoryview) -> Sequence[WrongFrame]:
    buffer.sync_begin(write=False)
    try:
        return part.judge(reply)
    finally:
        buffer.sync_end(write=False)


Pace = Callable[[float, Callable[[], None]], None]  # seconds of a slice, and what goes on after a pause


class Scan:
    """One pass over a region, in the worker's thread: `step` by step until the last, and then `close`; or `run`."""

    def __init__(self, what: Checked, state: ManagerState, devices: Devices) -> None:
        self.what = what
        self.wrong: list[WrongFrame] = []
        self._state, self._devices = state, devices
        self._at = 0
        self._reader: Reader | None = None

    def run(self) -> None:
        """All of it at once. Raises what went wrong."""
        try:
            while not self.step():
                pass
        finally:
            self.close()

    def step(self) -> bool:
        """Read a slice; whether that was the last. Raises RegionBusy if the region was changed meanwhile."""
        what = self.what
        held = self._state.board.region(what.region.name)
        if held.phase is not RegionPhase.READY or held.sha256 != what.image.sha256:
            raise RegionBusy(f"region {what.region.name} was changed while it was compared; ask again")
        if self._reader is None:
            self._reader = Reader(self._devices.icap(what.region.loader_name))
        slices = what.frames.slices(self._reader.most_frames(what.frames.frame_bytes))
        if self._at < len(slices):
            self.wrong.extend(self._reader.read(slices[self._at]))
            self._at += 1
        if self._at < len(slices):
            return False
        self.wrong.extend(self._reader.rest())
        return True

    def close(self) -> None:
        """Give back what it took of the port."""
        if self._reader is not None:
            self._reader.close()
            self._reader = None

    def result(self, seconds: float) -> RegionCheck:
        """As it is told."""
        what, wrong = self.what, self.wrong
        verdict = "wrong" if wrong else "good" if what.frames.judged else "unjudged"
        bits = sum(len(frame.bits) for frame in wrong)
        return RegionCheck(
            region=what.region.name,
            module=what.module.name,
            verdict=verdict,
            frames=what.frames.judged,
            unjudged=len(what.frames.unjudged),
            why=what.frames.why,
            wrong_frames=len(wrong),
            wrong_bits=bits,
            wrong=tuple(_frame_error(frame) for frame in wrong[:_LISTED]),
            seconds=seconds,
            config_name=what.config.name,
            mode=what.mode,
        )


def _frame_error(frame: WrongFrame) -> FrameError:
    at = frame.address
    return FrameError(frame.far, at.block_type, at.row, at.column, at.minor, frame.bits[:_BITS])


def bits_of(wrong: Sequence[WrongFrame]) -> frozenset[tuple[int, int]]:
    """Frame address and bit of each."""
    return frozenset((frame.far, bit) for frame in wrong for bit in frame.bits)
