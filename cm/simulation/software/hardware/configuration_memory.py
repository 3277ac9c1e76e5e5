# SPDX-License-Identifier: Apache-2.0
"""Configuration memory: which regions a bitstream writes, and which module it leaves in them.

And what is in its frames: for reading back, and for bits that radiation has turned over.
"""

from __future__ import annotations

import hashlib
import logging
import random
import zlib
from collections.abc import Iterable, Iterator, Mapping

from cm.device.native.bitstream import swap
from cm.formats.bitstream.assemble import FrameRun, assemble_stream
from cm.formats.bitstream.geometry import FrameAddress, FrameOrder, decode_far, frame_order
from cm.formats.bitstream.idcodes import Device
from cm.formats.bitstream.packets import PIPELINE
from cm.formats.bitstream.simulated_module import ModuleIdentity
from cm.frozen import dataclass, field
from cm.schema.model import FrameRange
from cm.simulation.software.hardware.board_spec import BoardSpec, ModuleSpec, RegionSpec
from cm.simulation.software.hardware.configuration_port import Arrival
from cm.simulation.software.hardware.fabric import Fabric
from cm.simulation.software.hardware.register_windows import Region

_log = logging.getLogger(__name__)
_SHARED = 2  # from this block type on, frames belong to no region: partial bitstreams of all regions write the same
_SYNC = b"\x66\x55\x99\xaa"
_NOP = b"\x00\x00\x00\x20"
_WAITING = 8  # loads that may wait to be sorted


class Frames:
    """Frames by FAR, as numbers; none where the device's columns are not public.

    Loads only leave their words here; they are sorted into frames when somebody reads, or turns bits over.
    """

    def __init__(self, device: Device) -> None:
        self.device = device
        self._size = 4 * device.family.frame_words
        self._frames: dict[int, int] = {}
        self._waiting: dict[tuple[tuple[int, int], ...], bytearray] = {}
        self._random = random.Random(1)
        self.upset: dict[int, int] = {}  # frames that were hit since they were written: the bits, as a number

    @property
    def _order(self) -> FrameOrder | None:  # made when it is asked for, and kept: most boards are never read back
        return frame_order(self.device.name, self.device.family)

    def loaded(self, stream: bytearray, key: tuple[tuple[int, int], ...]) -> None:
        """A load has ended, well or not; one with the same `key` has written the same frames. `stream` is kept."""
        self._waiting.pop(key, None)
        self._waiting[key] = stream
        if self.upset or len(self._waiting) > _WAITING:
            self._sorted()

    def clear(self) -> None:
        """Nothing is configured, as after power-up."""
        self._waiting.clear()
        self._frames.clear()
        self.upset.clear()

    def spoilt(self, stream: memoryview) -> Iterator[int]:
        """The frames that a bitstream would change in other bits than those that were hit."""
        there = self._sorted()
        for far, frame in self._of(stream).items():
            if far not in there or (there[far] ^ frame) & ~self.upset.get(far, 0):
                yield far

    def read(self, far: int, words: int) -> bytes:
        """What the port gives for a read of FDRO, as for DMA: words ahead, a frame of padding, frames from `far` on."""
        there = self._sorted()
        count = max(0, (words - PIPELINE[self.device.family]) // (self._size // 4) - 1)
        order = self._order
        begin = None if order is None else order.place.get(far)
        places = [] if begin is None or order is None else order.order[begin : begin + count]
        frames = (0 if place is None else there.get(place, 0) for place in places)
        data = b"".join(frame.to_bytes(self._size, "little") for frame in frames)
        return bytes(4 * words - count * self._size) + data.ljust(count * self._size, b"\0")

    def held(self, columns: Iterable[tuple[int, int, int]]) -> list[int]:
        """The frames of some columns (block type, row, column) that were written, in order."""
        wanted, family = set(columns), self.device.family
        found = ((far, decode_far(far, family)) for far in sorted(self._sorted()))
        return [far for far, place in found if (place.block_type, place.row, place.column) in wanted]

    def hit(self, among: list[int], bit: int | None = None) -> tuple[int, int]:
        """Turn a bit of one of some frames over, a random one by default; returns FAR, and 32 times the word and bit.

        Raises IndexError for a bit that no frame has.
        """
        far = self._random.choice(among)
        bit = self._random.randrange(8 * self._size) if bit is None else bit
        if not 0 <= bit < 8 * self._size:
            raise IndexError(bit)
        self._frames[far] = self._sorted()[far] ^ 1 << bit
        self.upset[far] = self.upset.get(far, 0) ^ 1 << bit
        if not self.upset[far]:
            del self.upset[far]
        return far, bit

    def stream(self, far: int) -> bytes:
        """A bitstream that writes one frame as it is, for what follows the frames by itself."""
        frame = swap(self._frames[far].to_bytes(self._size, "little"))
        run = FrameRun(decode_far(far, self.device.family), frame + bytes(len(frame)))
        return swap(assemble_stream(self.device, [[run]]))

    def _sorted(self) -> Mapping[int, int]:
        for stream in self._waiting.values():
            written = self._of(memoryview(stream))
            self._frames.update(written)
            self.upset = {far: bits for far, bits in self.upset.items() if far not in written}
        self._waiting.clear()
        return self._frames

    def _of(self, stream: memoryview) -> Mapping[int, int]:
        from cm.formats.bitstream.memory import dma_image, frames_of  # here: most boards are never read back

        order = self._order
        return {} if order is None else frames_of(dma_image(stream), order)


@dataclass(slots=True)
class _Touched:
    """What one load has written in one region."""

    mends: bool  # frames differ only in bits that had turned over: what runs there goes on
    addresses: list[FrameAddress] = field(default_factory=list)
    module: ModuleIdentity | None = None


class ConfigMemory:
    """Follows one load at a time."""

    def __init__(self, fabric: Fabric, known: Mapping[str, ModuleSpec]) -> None:
        """`known` are modules by the `digest` of their bitstreams, for bitstreams of other tools."""
        self._fabric = fabric
        self._known = known
        self._touched: dict[str, _Touched] = {}
        self._written: list[tuple[int, int]] = []
        self._mended: set[str] = set()
        self._stream = bytearray()  # of the load, as far as it has come: copied while the port is busy anyway
        self.frames = Frames(fabric.spec.device)
        self.outside = 0  # frame writes that hit no region, in partial loads, since the start

    def begin(self, stream: memoryview) -> None:
        """A load begins. If bits were hit, one that only puts them right lets its regions run on."""
        self._stream = bytearray()
        if self.frames.upset:
            family = self.frames.device.family
            spoilt = {self._region_at(decode_far(far, family)) for far in self.frames.spoilt(stream)}
            self._mended = {name for name, region in self._fabric.regions.items() if region not in spoilt}

    def apply(self, writes: Iterable[Arrival], full: bool, words: memoryview) -> None:
        """Words, and with them frames, have arrived: the regions they lie in hold no module any more."""
        self._stream += words
        for write in writes:
            address = decode_far(write.far, self.frames.device.family)
            self._written.append((write.far, write.words))
            if address.block_type >= _SHARED:
                continue
            region = self._region_at(address)
            if region is None:
                self.outside += not full
                continue
            mends = region.name in self._mended and region.running
            touched = self._touched.setdefault(region.name, _Touched(mends))
            touched.addresses.append(address)
            touched.module = touched.module or write.module
            if not (touched.mends or region.loading):
                self._fabric.start_load(region)

    def settle(self, ok: bool, sound: int, started: bool) -> None:
        """The load is over: regions that it covered run their module if it went well, or else nothing.

        `started`: it had a START, without which frames are only written over. `sound`: bytes that the port has taken,
        up to the first error.
        """
        words, self._stream = self._stream, bytearray()
        del words[sound:]
        if self._written:
            self.frames.loaded(words, tuple(self._written))
        stream = memoryview(words)
        self._written.clear()
        self._mended.clear()
        if ok:
            self._fabric.configured(stream)
        for name, touched in self._touched.items():
            region = self._fabric.regions[name]
            if touched.mends and not started:
                self._fabric.altered(region)
                continue
            module = self._module(region.spec, touched, stream) if ok else None
            self._fabric.end_load(region, module)
        self._touched.clear()

    def hit(self, name: str, bits: int, far: int | None = None, bit: int | None = None) -> list[tuple[int, int]]:
        """Turn over bits of a region's frames, random ones of logic and routing unless they are named.

        Returns frame address and bit (32 times the word, and the bit in it) of each. Raises KeyError for a region or
        frame that holds nothing.
        """
        region = self._fabric.regions[name]
        held = self.frames.held(_columns(region.spec))
        if not held or (far is not None and far not in held):
            raise KeyError(name)
        held = [one for one in held if decode_far(one, self.frames.device.family).block_type == 0]
        hits = [self.frames.hit(held if far is None else [far], bit) for _ in range(bits)]
        for chosen in {chosen for chosen, _ in hits}:
            self._fabric.configured(memoryview(self.frames.stream(chosen)))
        self._fabric.altered(region)
        return hits

    def _region_at(self, address: FrameAddress) -> Region | None:
        for region in self._fabric.regions.values():
            if any(_inside(address, frames) for frames in region.spec.footprint):
                return region
        return None

    def _module(self, region: RegionSpec, touched: _Touched, stream: memoryview) -> ModuleSpec | None:
        if touched.module is None:
            known = self._known.get(digest(stream)) if self._known else None
            return known if known is not None and _begun(region, touched.addresses) else None
        if not _covered(region, touched.addresses):
            _log.warning("a bitstream of %s does not cover region %s", touched.module.name, region.name)
            return None
        return module_named(self._fabric.spec, touched.module, region.name)


def _columns(region: RegionSpec) -> Iterable[tuple[int, int, int]]:
    """Its columns of logic and routing, and of block RAM's contents."""
    for frames in region.footprint:
        if frames.block_type < _SHARED:
            for column in range(frames.column_first, frames.column_last + 1):
                yield frames.block_type, frames.row, column


def module_named(spec: BoardSpec, identity: ModuleIdentity, region: str) -> ModuleSpec:
    """The module as the schemas know it, or one without registers if they do not."""
    for module in spec.modules:
        if module.name == identity.name and module.region == region:
            return module
    return ModuleSpec("", identity.name, region, identity.model, zlib.crc32(identity.name.encode()))


def digest(words: bytes | memoryview) -> str:
    """The hash of a configuration stream in memory order, from its sync word on, without padding after it."""
    data = bytes(words)
    start, end = max(0, data.find(_SYNC)), len(data)
    while end - start >= 4 and data[end - 4 : end] in (_NOP, bytes(4)):
        end -= 4
    return hashlib.sha256(memoryview(data)[start:end]).hexdigest()


def _inside(address: FrameAddress, frames: FrameRange) -> bool:
    return (
        address.block_type == frames.block_type
        and address.row == frames.row
        and frames.column_first <= address.column <= frames.column_last
    )


def _covered(region: RegionSpec, addresses: list[FrameAddress]) -> bool:
    """Whether every column was written; our assembler begins a run in each."""
    return set(_columns(region)) <= {(address.block_type, address.row, address.column) for address in addresses}


def _begun(region: RegionSpec, addresses: list[FrameAddress]) -> bool:
    """Whether something was written in every range; runs of other tools continue over several columns."""
    own = (frames for frames in region.footprint if frames.block_type < _SHARED)
    return all(any(_inside(address, frames) for address in addresses) for frames in own)
