# SPDX-License-Identifier: Apache-2.0
"""Configuration memory: which regions a bitstream writes, and which module it leaves in them."""

from __future__ import annotations

import hashlib
import logging
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from cm.device.native.bitstream import swap
from cm.formats.bitstream.assemble import FrameRun, assemble_stream
from cm.formats.bitstream.devices import Device
from cm.formats.bitstream.geometry import FrameAddress, decode_far
from cm.formats.bitstream.module import ModuleIdentity
from cm.schema.model import FrameRange
from cm.simulation.software.hardware.board_spec import BoardSpec, ModuleSpec, RegionSpec
from cm.simulation.software.hardware.configuration_frames import Frames
from cm.simulation.software.hardware.configuration_port import FrameWrite
from cm.simulation.software.hardware.fabric import Fabric
from cm.simulation.software.hardware.register_windows import Region

_log = logging.getLogger(__name__)
_SHARED = (
    2  # from this block type on, frames belong to no region: partial bitstreams of all regions write the same ones
)
_SYNC = b"\x66\x55\x99\xaa"
_NOP = b"\x00\x00\x00\x20"


@dataclass(slots=True)
class _Touched:
    """What one load has written in one region."""

    addresses: list[FrameAddress] = field(default_factory=list)
    module: ModuleIdentity | None = None
    mends: bool = True  # frames differed only in bits that had turned over: what runs there goes on


class ConfigMemory:
    """Follows one load at a time."""

    def __init__(self, fabric: Fabric, known: Mapping[str, ModuleSpec]) -> None:
        """`known` are modules by the `digest` of their bitstreams, for bitstreams of other tools."""
        self._fabric = fabric
        self._known = known
        self._touched: dict[str, _Touched] = {}
        self._written: list[tuple[int, int]] = []
        self.frames = Frames(fabric.spec.device)
        self.outside = 0  # frame writes that hit no region, in partial loads, since the start

    def apply(self, writes: Iterable[FrameWrite], full: bool) -> None:
        """Frames have arrived: the regions they lie in hold no module any more."""
        for write in writes:
            if write.again is not None:
                continue
            self._written.append((write.far, write.words))
            if write.address.block_type >= _SHARED:
                continue
            region = self._region_at(write.address)
            if region is None:
                self.outside += not full
                continue
            touched = self._touched.setdefault(region.name, _Touched())
            touched.addresses.append(write.address)
            touched.module = touched.module or write.module
            touched.mends &= bool(write.data) and region.running and self.frames.only_mends(write)
            if not (touched.mends or region.loading):
                self._fabric.start_load(region)

    def settle(self, ok: bool, stream: memoryview, started: bool) -> None:
        """The load is over: regions that it covered run their module if it went well, or else nothing.

        `started`: it had a START, without which frames are only written over. `stream`: what the port has taken.
        """
        self.frames.loaded(stream, tuple(self._written))
        self._written.clear()
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
        hits = []
        for _ in range(bits):
            chosen = self.frames.pick(held) if far is None else far
            hits.append((chosen, self.frames.hit(chosen, bit)))
        for chosen in {chosen for chosen, _ in hits}:
            self._fabric.configured(memoryview(_stream(self._fabric.spec.device, chosen, self.frames.frame(chosen))))
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


def _stream(device: Device, far: int, frame: bytes) -> bytes:
    """A bitstream that writes one frame, for what follows the frames by itself."""
    run = FrameRun(decode_far(far, device.family), swap(frame) + bytes(len(frame)))
    return swap(assemble_stream(device, [[run]]))


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
    written = {(address.block_type, address.row, address.column) for address in addresses}
    return all(
        (frames.block_type, frames.row, column) in written
        for frames in region.footprint
        if frames.block_type < _SHARED
        for column in range(frames.column_first, frames.column_last + 1)
    )


def _begun(region: RegionSpec, addresses: list[FrameAddress]) -> bool:
    """Whether something was written in every range; runs of other tools continue over several columns."""
    own = (frames for frames in region.footprint if frames.block_type < _SHARED)
    return all(any(_inside(address, frames) for address in addresses) for frames in own)
