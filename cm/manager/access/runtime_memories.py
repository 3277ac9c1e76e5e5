# SPDX-License-Identifier: Apache-2.0
"""Memories that are defined at run time: from a request to a memory, checked against the configuration."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator
from dataclasses import replace

from cm.errors import InvalidRequest
from cm.manager.interfaces import AddressRange
from cm.manager.planning.goals import listed
from cm.schema.model import ITEM_BYTES, Access, Config, Memory
from cm.wire.messages.requests import DefineMemory

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_-]{0,63}")
_ACCESS = {"": Access.RW, "rw": Access.RW, "ro": Access.RO, "wo": Access.WO}
_WORD = 4
_Span = tuple[int, int, str, str | None]  # first address, the one after the last, what is there, its region


def requested(request: DefineMemory, config: Config) -> Memory:
    """The memory that a request describes, with its region still open. Raises InvalidRequest."""
    name = request.name
    _check_name(name, config)
    if request.address is None or not request.length:
        missing = "length" if request.length == 0 else "address"
        raise InvalidRequest(f"memory {name!r}: {missing} is missing; address and length, in bytes, define a memory")
    if request.address % _WORD or request.length % _WORD:
        place = f"{request.length} bytes at {request.address:#x}"
        raise InvalidRequest(f"memory {name!r}: {place} are not whole words: multiples of {_WORD} are")
    if request.address + request.length > 1 << 64:
        raise InvalidRequest(f"memory {name!r}: it ends behind the last address of 64 bits")
    if request.access not in _ACCESS:
        raise InvalidRequest(f"memory {name!r}: access {request.access!r}; it is one of rw, ro, wo")
    dtype = request.dtype or "uint32"
    memory = Memory(
        name, request.address, request.length, 0, _ACCESS[request.access], dtype, request.shape or None, doc=""
    )
    _check_form(memory)
    return memory


def placed(memory: Memory, region: str, config: Config, window: AddressRange) -> Memory:
    """`memory` in the region that is named, or in that of other things with names in the same window.

    Raises InvalidRequest.
    """
    if region:
        if region != "static" and region not in config.regions:
            known = listed([*config.regions, "static"])
            raise InvalidRequest(f"memory {memory.name!r}: there is no region {region!r}; there are {known}")
        return replace(memory, region=None if region == "static" else region)
    named = list(_named(config))
    over = {owner for start, end, _, owner in named if start < memory.end and memory.address < end}
    near = {owner for start, _, _, owner in named if window.address <= start < window.address + window.size}
    owners = over or near or {None}
    if len(owners) > 1:
        names = listed(owner or "static" for owner in owners)
        raise InvalidRequest(f"memory {memory.name!r}: region is missing; its window has registers of {names}")
    return replace(memory, region=owners.pop())


def check_covered(memory: Memory, config: Config, mode: str | None, others: Iterable[Memory]) -> None:
    """Raise InvalidRequest if a writable memory covers something that has a name in `mode`."""
    if memory.access is Access.RO:
        return
    for start, end, what, _ in (*_registers(config, mode), *_memories(others), *_fixed(config)):
        if start < memory.end and memory.address < end:
            raise InvalidRequest(
                f"memory {memory.name!r} covers {what} at {start:#x}, which has rights and limits of its own: "
                "take another place, or access ro"
            )


def _check_name(name: str, config: Config) -> None:
    if not _NAME.fullmatch(name):
        raise InvalidRequest(f"memory {name[:80]!r}: letters, digits, _ and - make a name, at most 64, no digit first")
    for mode in config.modes.values():
        for kind, names in (("stream", mode.streams), ("memory", config.visible_memories(mode.name))):
            if name in names:
                raise InvalidRequest(f"{name!r} is a {kind} of configuration {config.name!r}: give another name")


def _check_form(memory: Memory) -> None:
    if memory.dtype not in ITEM_BYTES:
        raise InvalidRequest(f"memory {memory.name!r}: no dtype {memory.dtype!r}; there are {', '.join(ITEM_BYTES)}")
    if memory.shape is None:
        fits = memory.size % memory.item == 0
        form = f"whole elements of {memory.dtype}"
    else:
        fits = math.prod(memory.shape) * memory.item == memory.size
        form = f"shape {list(memory.shape)} of {memory.dtype}"
    if not fits:
        raise InvalidRequest(f"memory {memory.name!r}: its {memory.size} bytes are not {form}")


def _named(config: Config) -> Iterator[_Span]:
    """Every place that has a name in some mode."""
    for mode in config.modes:
        yield from _registers(config, mode)
        yield from _memories(config.visible_memories(mode).values())
    yield from _fixed(config)


def _registers(config: Config, mode: str | None) -> Iterator[_Span]:
    for r in config.visible_registers(mode).values():
        yield r.address, r.address + r.width // 8, f"register {r.name!r}", r.region


def _memories(memories: Iterable[Memory]) -> Iterator[_Span]:
    for m in memories:
        yield m.address, m.end, f"memory {m.name!r}", m.region


def _fixed(config: Config) -> Iterator[_Span]:
    for name, region in config.regions.items():
        for what, part, owner in (("decoupler", region.decoupler, None), ("identity", region.identity, name)):
            if part is not None and part.size:
                start = part.base_address + part.offset
                yield start, start + part.size, f"the {what} of region {name!r}", owner
