# SPDX-License-Identifier: Apache-2.0
"""What must be true of memories: whole words, a shape that fits, a unique name and a place that nothing else has."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Iterator, Mapping
from typing import NamedTuple

from cm.schema.construct import Context, memory_key
from cm.schema.model import Config, Memory, Mode, Register
from cm.schema.problems import KeyPath, did_you_mean, key_path

WORD = 4  # bytes of one access; places and sizes are multiples of it
_LONGEST = 8  # bytes of a register


class _Span(NamedTuple):
    """A place, and what is there."""

    start: int
    end: int
    what: str
    path: KeyPath


def check_memories(config: Config, context: Context) -> None:
    """Report every memory of `config` that breaks a rule."""
    streams = _streams(config)
    for path, memory in _all(config, context):
        _check_place(memory, path, config, context)
        _check_form(memory, path, context)
        if memory.name in streams:
            hint = f"{key_path(streams[memory.name])}: data are read and written by name, so give one another name"
            context.report(path, "name_clash", f"a stream is called {memory.name} too", hint)
    _Places(config, context).check()


def _streams(config: Config) -> dict[str, KeyPath]:
    found: dict[str, KeyPath] = {}
    for mode in config.modes.values():
        for name in mode.streams:
            found.setdefault(name, ("config", "modes", mode.name, "streams", name))
    return found | {name: ("config", "streams", name) for name in config.streams}


def _all(config: Config, context: Context) -> Iterator[tuple[KeyPath, Memory]]:
    owners: list[tuple[KeyPath, dict[str, Memory]]] = [(("config",), dict(config.memories))]
    owners += [(("config", "modules", name), dict(module.memories)) for name, module in config.modules.items()]
    owners += [(("config", "modes", name), dict(mode.memories)) for name, mode in config.modes.items()]
    for owner, memories in owners:
        for name, memory in memories.items():
            yield context.where[memory_key(owner, name)], memory


def _check_place(memory: Memory, path: KeyPath, config: Config, context: Context) -> None:
    if memory.address % WORD:
        message = f"a memory at address {memory.address:#x}"
        context.report((*path, "offset"), "misaligned_offset", message, f"a multiple of {WORD}")
    if memory.size % WORD:
        low = memory.size // WORD * WORD
        hint = f"accesses have 32 bits: {f'{low} or ' if low else ''}{low + WORD}"
        context.report((*path, "size"), "bad_value", f"size {memory.size} is not a multiple of {WORD}", hint)
    if memory.end > 1 << 64:
        context.report((*path, "size"), "value_range", f"it ends at {memory.end:#x}", "addresses have 64 bits")
    if memory.region is not None and memory.region not in config.regions:
        hint = did_you_mean(memory.region, [*config.regions, "static"])
        context.report((*path, "region"), "unknown_region", f"there is no region {memory.region}", hint)


def _check_form(memory: Memory, path: KeyPath, context: Context) -> None:
    item = memory.item
    if memory.shape is None:
        if memory.size % item and memory.size % WORD == 0:  # else its size was reported
            hint = f"a multiple of {item}"
            context.report((*path, "size"), "bad_value", f"{memory.size} bytes are not whole {memory.dtype}s", hint)
        return
    length = math.prod(memory.shape) * item
    if length != memory.size:
        message = f"{list(memory.shape)} of {memory.dtype} are {length} bytes, the memory has {memory.size}"
        context.report((*path, "shape"), "bad_value", message, "the shape is that of the whole memory")


class _Places:
    """Memories must not overlap registers, each other, decouplers or identity registers."""

    def __init__(self, config: Config, context: Context) -> None:
        self._config, self._context = config, context
        self._reported: set[tuple[KeyPath, KeyPath]] = set()
        self._fixed = list(self._fixed_spans())
        self._own = sorted(self._spans(("config",), config.registers), key=_start)

    def check(self) -> None:
        """Check each mode's memories against everything else that is visible in it."""
        for mode in self._config.modes.values():
            self._check_mode(mode)

    def _check_mode(self, mode: Mode) -> None:
        memories: dict[str, tuple[KeyPath, Memory]] = {}
        for path, memory in self._visible(mode):
            other = memories.setdefault(memory.name, (path, memory))
            if not _same_place(other[1], memory):
                hint = f"{key_path(other[0])} is at {other[1].address:#x}, {other[1].size} bytes"
                self._report(path, other[0], "name_clash", f"memory {memory.name} is elsewhere too", hint)
        if not memories:
            return
        added = [*self._fixed, *self._added(mode)]
        spans = [_Span(m.address, m.end, f"memory {m.name}", path) for path, m in memories.values()]
        for index, span in enumerate(spans):
            for other_span in (*self._own_over(span), *_over(added, span), *_over(spans[:index], span)):
                place = f"{key_path(other_span.path)} is at {other_span.start:#x} to {other_span.end - 1:#x}"
                message = f"{span.what} overlaps {other_span.what}"
                self._report(span.path, other_span.path, "overlapping_memory", message, place)

    def _visible(self, mode: Mode) -> Iterator[tuple[KeyPath, Memory]]:
        config, where = self._config, self._context.where
        for name, memory in config.memories.items():
            yield where[memory_key(("config",), name)], memory
        for module in dict.fromkeys(mode.modules):
            if module in config.modules:
                for name, memory in config.modules[module].memories.items():
                    yield where[memory_key(("config", "modules", module), name)], memory
        for name, memory in mode.memories.items():
            yield where[memory_key(("config", "modes", mode.name), name)], memory

    def _added(self, mode: Mode) -> Iterator[_Span]:
        """The registers that are visible in `mode` beside the configuration's."""
        for module in mode.modules:
            if module in self._config.modules:
                yield from self._spans(("config", "modules", module), self._config.modules[module].registers)
        yield from self._spans(("config", "modes", mode.name), mode.registers)

    def _spans(self, owner: KeyPath, registers: Mapping[str, Register]) -> Iterator[_Span]:
        for name, r in registers.items():
            yield _Span(r.address, r.address + r.width // 8, f"register {name}", self._context.where[owner, name])

    def _fixed_spans(self) -> Iterator[_Span]:
        """Registers by which the manager changes regions."""
        for name, region in self._config.regions.items():
            for key, part in (("decoupler", region.decoupler), ("identity", region.identity)):
                if part is not None and part.size:
                    start = part.base_address + part.offset
                    what = f"the {key} of region {name}"
                    yield _Span(start, start + part.size, what, ("config", "regions", name, key))

    def _own_over(self, span: _Span) -> Iterator[_Span]:
        """The configuration's registers that overlap `span`, in order; there may be many."""
        index = bisect_left(self._own, span.start - _LONGEST + 1, key=_start)
        while index < len(self._own) and self._own[index].start < span.end:
            if self._own[index].end > span.start:
                yield self._own[index]
            index += 1

    def _report(self, path: KeyPath, other: KeyPath, code: str, message: str, hint: str) -> None:
        if (path, other) not in self._reported:  # the same pair is visible in several modes
            self._reported.add((path, other))
            self._context.report(path, code, message, hint)


def _start(span: _Span) -> int:
    return span.start


def _over(spans: list[_Span], span: _Span) -> Iterator[_Span]:
    return (other for other in spans if other.start < span.end and span.start < other.end)


def _same_place(one: Memory, other: Memory) -> bool:
    return (one.address, one.size, one.region) == (other.address, other.size, other.region)
