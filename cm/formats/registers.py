# SPDX-License-Identifier: Apache-2.0
"""The register map of a module as any tool describes it, and the one way from there to a runtime schema.

Every reader (.hwh, IP-XACT, SystemRDL, HLS, LiteX, …) gives items of this model, in the words of IP-XACT (IEEE 1685);
`RegisterBank` makes registers and memories of them. What a schema cannot have is left out, and named in a note.
"""

from __future__ import annotations

import itertools
import re
import unicodedata
from collections.abc import Iterable, Iterator, Mapping
from types import MappingProxyType
from typing import Any, TypeAlias

from cm.frozen import dataclass, field, replace
from cm.schema.model import Access, BitField, FieldAccess, Memory, Register

LONGEST = 64  # letters of a name
_LARGEST = 1 << 30  # bytes of a memory, at most
_MOST = 1024  # registers that one array becomes
_ALSO = "Same address:"
Dims: TypeAlias = "tuple[tuple[int, int], ...]"  # count, and bytes from one to the next


def _empty() -> Mapping[Any, Any]:
    return MappingProxyType({})


@dataclass(frozen=True, slots=True)
class RegisterField:
    """A field. `access` (``read-only``, …), `write` and `read`, IP-XACT's modifiedWriteValue and readAction, or empty.

    `reset` is None where nobody knows it, as of bits that the hardware drives.
    """

    name: str
    lsb: int
    width: int
    access: str = ""
    write: str = ""
    read: str = ""
    reset: int | None = None
    values: Mapping[str, int] = field(default_factory=_empty)
    volatile: bool = False
    doc: str = ""


@dataclass(frozen=True, slots=True)
class RegisterInfo:
    """A register: `offset` bytes from its block, `size` bits, accesses of at most `widest` bits (0: of any width)."""

    name: str
    offset: int
    size: int
    access: str = ""
    reset: int | None = None
    fields: tuple[RegisterField, ...] = ()
    doc: str = ""
    dims: Dims = ()
    widest: int = 0
    volatile: bool = False


@dataclass(frozen=True, slots=True)
class MemoryInfo:
    """A memory of `size` bytes (0: up to what follows), of elements of `width` bits."""

    name: str
    offset: int
    size: int
    access: str = ""
    width: int = 32
    shape: tuple[int, ...] | None = None
    doc: str = ""
    dims: Dims = ()


@dataclass(frozen=True, slots=True)
class BlockInfo:
    """Registers that belong together: a register file, or a block inside a block."""

    name: str
    offset: int
    items: tuple[RegisterInfo | MemoryInfo | BlockInfo, ...]
    dims: Dims = ()


Item: TypeAlias = "RegisterInfo | MemoryInfo | BlockInfo"


def unaccented(text: str) -> str:
    """`text` with ``u`` for ``ü`` and ``ss`` for ``ß``."""
    letters = unicodedata.normalize("NFKD", text.replace("ß", "ss"))
    return "".join(letter for letter in letters if not unicodedata.combining(letter))


def identifier(name: str) -> str:
    """`name` as a name of the runtime schema: lower case, accents removed, other characters as underscores."""
    text = re.sub(r"\W+", "_", unaccented(name), flags=re.ASCII).strip("_").lower()
    return text if text and not text[0].isdigit() else f"r_{text}"


class UniqueNames:
    """Gives each thing a name of its own: the second `irq` becomes `irq_2`; what is too long is cut."""

    def __init__(self, taken: Iterable[str] = (), longest: int = LONGEST) -> None:
        self._taken, self._longest = set(taken), longest

    def take(self, name: str) -> str:
        """A name made from `name` that nothing has yet."""
        found, count = name[: self._longest].rstrip("_-"), 1
        while found in self._taken:
            count += 1
            suffix = f"_{count}"
            found = name[: self._longest - len(suffix)].rstrip("_-") + suffix
        self._taken.add(found)
        return found


_KINDS = {"read-only": "ro", "write-only": "wo", "writeOnce": "wo", "read-write": "rw", "read-writeOnce": "rw"}
_LETTERS = (("Clear", "c"), ("Set", "s"), ("Toggle", "t"))
_WRITES = {
    **{f"oneTo{what}": f"w1{letter}" for what, letter in _LETTERS},
    **{f"zeroTo{what}": f"w0{letter}" for what, letter in _LETTERS},
    "clear": "wc",
    "set": "ws",
    "modify": "wc",
}
_READS = {"clear": "rc", "set": "rs", "modify": "rc"}


def field_access(access: str, write: str = "", read: str = "") -> FieldAccess | None:
    """What bits do, by IP-XACT's access, modifiedWriteValue and readAction; None if UVM has no word for it."""
    plain = _KINDS.get(access, "rw")
    writes = _WRITES.get(write, "")  # also of what is read-only beside it: so Vivado describes HLS' interrupt status
    reads = _READS.get(read, "") if plain != "wo" else ""
    words = {
        (False, False): plain,
        (True, False): writes,
        (False, True): reads if plain == "ro" else f"w{reads}",
        (True, True): f"{writes}{reads}",
    }
    word = words[bool(writes), bool(reads)]
    return FieldAccess(word) if word in {item.value for item in FieldAccess} else None


class RegisterBank:
    """Collects the registers and memories of windows.

    Of several registers at one address (aliases; a bit in a UART selects between them) the first is kept, and its
    `doc` names the others.
    """

    def __init__(self, notes: list[str], taken: Iterable[str] = ()) -> None:
        self._names = UniqueNames(taken)
        self._notes = notes
        self._taken: dict[tuple[int, int], str] = {}
        self.registers: dict[str, Register] = {}
        self.memories: dict[str, Memory] = {}

    def add(
        self, prefix: str, base: int, size: int | None, items: Iterable[Item], region: str | None = None, at: int = 0
    ) -> None:
        """Add what a window of `size` bytes (None: not known) at `base` holds, beginning at its byte `at`.

        Names begin with `prefix`, if it is not empty.
        """
        left: dict[str, list[str]] = {}
        window = _Window(f"{prefix}_" if prefix else "", base, size, region, left)
        found = list(self._flat(items, "", at, left))
        starts = sorted({item.offset for item in found})
        follows = dict(itertools.zip_longest(starts, starts[1:]))
        for item in found:
            if isinstance(item, MemoryInfo):
                self._memory(item, follows[item.offset], window)
            else:
                self._register(item, follows[item.offset], window)
        for why, names in left.items():
            shown = ", ".join(names[:5]) + (f" and {len(names) - 5} more" if len(names) > 5 else "")
            self._notes.append(f"{prefix + ': ' if prefix else ''}{why}: {shown}")

    def _flat(
        self, items: Iterable[Item], prefix: str, base: int, left: dict[str, list[str]]
    ) -> Iterator[RegisterInfo | MemoryInfo]:
        """Each register and memory by itself; arrays and blocks are unrolled, and long arrays of words are memories."""
        for item in items:
            block = _block(item)
            if block is not None:
                yield replace(block, name=prefix + block.name, offset=base + block.offset)
                continue
            places = list(itertools.islice(itertools.product(*(range(count) for count, _ in item.dims)), _MOST + 1))
            if len(places) > _MOST:
                left.setdefault(f"arrays of more than {_MOST}, left out", []).append(prefix + item.name)
                continue
            for place in places:
                at = base + item.offset + sum(n * step for n, (_, step) in zip(place, item.dims, strict=True))
                name = "_".join((prefix + item.name, *map(str, place)))
                if isinstance(item, BlockInfo):
                    yield from self._flat(item.items, f"{name}_" if name else "", at, left)
                elif isinstance(item, RegisterInfo):
                    yield from _accesses(_as_hls_does(replace(item, name=name, offset=at, dims=())), left)
                else:
                    yield replace(item, name=name, offset=at, dims=())

    def _register(self, info: RegisterInfo, follows: int | None, window: _Window) -> None:
        begin = window.base + info.offset
        width = _access_width(info.size, begin, None if follows is None else follows - info.offset)
        if width is None or (window.size is not None and info.offset + width // 8 > window.size):
            window.leave("no plain registers, left out", info.name)
            return
        end = begin + width // 8
        there = next((name for (first, last), name in self._taken.items() if begin < last and first < end), None)
        if there is not None:
            window.leave("at the address of another, whose doc names it", info.name)
            if there in self.registers:
                found = self.registers[there]
                more = f"{found.doc.removesuffix('.')}," if _ALSO in found.doc else f"{found.doc} {_ALSO}"
                self.registers[there] = replace(found, doc=f"{more} {info.name.lower()}.".strip())
            return
        name = self._taken[begin, end] = self._names.take(identifier(window.prefix + info.name))
        self.registers[name] = _register(name, width, info, window)

    def _memory(self, info: MemoryInfo, follows: int | None, window: _Window) -> None:
        until = min((end for end in (follows, window.size) if end is not None), default=info.offset)
        size = (info.size or until - info.offset) + 3 & -4
        begin = window.base + info.offset
        beyond = window.size is not None and info.offset + size > window.size
        taken = any(begin < last and first < begin + size for first, last in self._taken)
        if not 0 < size <= _LARGEST or begin % 4 or beyond or taken:
            window.leave("no memories that a schema can have, left out", info.name)
            return
        name = self._taken[begin, begin + size] = self._names.take(identifier(window.prefix + info.name))
        item = next((bits for bits in (8, 16, 32, 64) if info.width <= bits), 32)
        dtype = f"uint{item}" if size % (item // 8) == 0 else "uint32"
        access = {"ro": Access.RO, "wo": Access.WO}.get(_KINDS.get(info.access, ""), Access.RW)
        self.memories[name] = Memory(
            name, window.base, size, info.offset, access, dtype, info.shape, window.region, _one_line(info.doc)
        )


@dataclass(frozen=True, slots=True)
class _Window:
    """Where the items of one call lie, and what of them was left out: why → names."""

    prefix: str
    base: int
    size: int | None
    region: str | None
    left: dict[str, list[str]]

    def leave(self, why: str, name: str) -> None:
        names = self.left.setdefault(why, [])
        if name not in names:
            names.append(name)


def _block(item: Item) -> MemoryInfo | None:
    """An array of words without fields that is too long for registers, as a memory; HLS's arrays too."""
    if not isinstance(item, RegisterInfo):
        return None
    if item.name.startswith("Memory_"):  # Vitis HLS; its size is not that of a register
        return MemoryInfo(item.name.removeprefix("Memory_"), item.offset, 0, item.access, doc=item.doc)
    total = 1
    for count, step in reversed(item.dims):
        if step * 8 != item.size * total:
            return None
        total *= count
    if total <= _MOST or item.fields or item.size not in (8, 16, 32, 64):
        return None
    return MemoryInfo(item.name, item.offset, total * item.size // 8, item.access, item.size, doc=item.doc)


def _as_hls_does(info: RegisterInfo) -> RegisterInfo:
    """HLS' control register with what its bits do, which Vivado's files do not say (UG1399, S_AXILITE control)."""
    fields = {item.name.lower(): item for item in info.fields}
    if not {"ap_start", "ap_done"} <= fields.keys():
        return info
    fields["ap_start"] = replace(fields["ap_start"], write="oneToSet")
    fields["ap_done"] = replace(fields["ap_done"], read="clear")
    return replace(info, fields=tuple(fields.values()))


def _accesses(info: RegisterInfo, left: dict[str, list[str]]) -> Iterator[RegisterInfo]:
    """The accesses that a register takes, each as one: ``name_0`` has its lowest bits."""
    longest = 64 if info.offset % 8 == 0 else 32  # none crosses what a bus transfers at once
    part = info.widest or min(info.size, longest)
    if info.size <= part:
        yield info
        return
    count = -(-info.size // part)
    for number in range(count):
        low = number * part
        bits = min(part, info.size - low)
        inside = [f for f in info.fields if low <= f.lsb and f.lsb + f.width <= low + bits]
        yield replace(
            info,
            name=f"{info.name}_{number}",
            offset=info.offset + low // 8,
            size=bits,
            widest=0,
            reset=None if info.reset is None else info.reset >> low & ((1 << bits) - 1),
            fields=tuple(replace(f, lsb=f.lsb - low) for f in inside),
        )
    cut = [f.name for f in info.fields if f.lsb // part != (f.lsb + f.width - 1) // part]
    if cut:
        left.setdefault("fields in two accesses, left out", []).extend(f"{info.name}.{name}" for name in cut)


def _access_width(size: int, address: int, room: int | None) -> int | None:
    """The access for a register of `size` bits: a whole word where it has one, as AXI4-Lite slaves expect.

    `room`: bytes up to the next register.
    """
    if 0 < size <= 32 and address % 4 == 0 and (room is None or room >= 4 or size > 8 * room):
        return 32
    width = next((bits for bits in (8, 16, 32, 64) if bits >= size > 0), None)
    return width if width is not None and address % (width // 8) == 0 else None


def _register(name: str, width: int, info: RegisterInfo, window: _Window) -> Register:
    whole = field_access(info.access) or FieldAccess.RW
    listed = list(_fields(info, width, window))
    does = {item.name: _within(whole, item, info, window) for item in listed}
    kinds = [access.kind for access in does.values()] or [whole.kind]
    if set(does.values()) == {FieldAccess.W1C}:
        access = Access.W1C
    elif not any(kind.writable for kind in kinds):
        access = Access.RO
    else:
        access = Access.RW if any(kind.readable for kind in kinds) else Access.WO
    fields = {}
    for item in listed:
        does_it = does[item.name]
        if not _is_whole(item, info, width) or does_it.value not in ("rw", "ro", "wo", "w1c") or item.values:
            own = None if does_it.value == access.value else does_it
            fields[item.name] = BitField(item.name, item.lsb, item.width, _one_line(item.doc), item.values, own)
    changes = info.volatile or access is Access.RO or any(item.volatile for item in listed)
    return Register(
        name=name,
        base_address=window.base,
        offset=info.offset,
        width=width,
        access=access,
        reset=None if access is Access.WO else _reset(info, width),
        fields=MappingProxyType(fields),
        region=window.region,
        volatile=changes or not all(kind in (FieldAccess.RW.kind, FieldAccess.WO.kind) for kind in kinds),
        doc=_one_line(info.doc),
    )


def _is_whole(item: RegisterField, info: RegisterInfo, width: int) -> bool:
    """Whether a field is only another name of its register."""
    return item.lsb == 0 and item.width in (width, info.size) and item.name == identifier(info.name.rpartition("_")[2])


def _within(whole: FieldAccess, item: RegisterField, info: RegisterInfo, window: _Window) -> FieldAccess:
    """What a field does in its register: no more than the register allows."""
    if item.access.endswith("Once"):
        window.leave("written once after a reset, a second write does nothing", f"{info.name}.{item.name}")
    own = field_access(item.access or info.access, item.write, item.read)
    if own is None:
        window.leave("reading changes it in another way than writing, which is not told", f"{info.name}.{item.name}")
        own = field_access(item.access or info.access, item.write) or FieldAccess.RW
    if "modify" in (item.write, item.read):
        window.leave("an access changes it, nobody says how", f"{info.name}.{item.name}")
    if (whole is FieldAccess.RO and own.kind.writable) or (whole is FieldAccess.WO and not own.kind.writable):
        return whole
    return own


def _reset(info: RegisterInfo, width: int) -> int | None:
    """The register's reset value, or that of its fields; unknown if one of theirs is."""
    value = info.reset
    if value is None and info.fields:
        known = [(item.reset, item.lsb) for item in info.fields if item.reset is not None]
        value = sum(reset << lsb for reset, lsb in known) if len(known) == len(info.fields) else None
    return value if value is not None and not value >> width else None


def _fields(info: RegisterInfo, width: int, window: _Window) -> Iterator[RegisterField]:
    """Fields that do not overlap, with names of the schema."""
    names, used = UniqueNames(), 0
    for item in info.fields:
        if item.name.upper().startswith("RESERVED"):
            continue
        mask = ((1 << max(item.width, 0)) - 1) << item.lsb
        if item.width < 1 or item.lsb + item.width > width or mask & used:
            why = "fields over others, left out" if mask & used else "fields outside of their register, left out"
            window.leave(why, f"{info.name}.{item.name}")
            continue
        used |= mask
        words = UniqueNames()
        values = {words.take(identifier(name)): value for name, value in item.values.items() if not value >> item.width}
        name = names.take(identifier(item.name))
        yield replace(item, name=name, values=MappingProxyType(values))


def _one_line(text: str) -> str:
    return " ".join(text.split())[:500]
