# SPDX-License-Identifier: Apache-2.0
"""Registers of modules that Vivado HLS or Vitis HLS wrote, from the files that it wrote with them.

``<top>_<bundle>_s_axi.v`` (or ``.vhd``) and the driver's ``x<top>_hw.h`` list the registers in a comment, the same in
every version since 2018 but for words; the HDL has their addresses as ``ADDR_…`` constants too, the header as
``…_ADDR_…`` macros. Both are read and have to agree. `component.xml` is read by `cm.design.hdl.register_maps`.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from cm.design.errors import BuildError
from cm.formats.registers import Item, MemoryInfo, RegisterField, RegisterInfo
from cm.schema.model import Register

HDL = re.compile(r".+_s_axi\.(?:v|sv|vhdl?)$", re.IGNORECASE)
HEADER = re.compile(r"x?\w+_hw\.h$", re.IGNORECASE)
_REGISTER = re.compile(r"^\s*(?://|--)\s*0x([0-9a-f]+)\s*:\s*(.*?)\s*$", re.IGNORECASE)
_ACCESS = r"(?:read|write|r|w|cor|tow|coh|sc)"
_FIELD = re.compile(
    rf"^\s*(?://|--)\s*bit\s+(\d+)(?:~(\d+))?\s*-\s*(.*?)\s*(?:\(({_ACCESS}(?:/{_ACCESS})*)\))?\s*$", re.IGNORECASE
)
_MEMORY = re.compile(r"^\s*(?://|--)\s*0x([0-9a-f]+)\s*~\s*$", re.IGNORECASE)
_ARRAY = re.compile(
    r"^\s*(?://|--)\s*0x([0-9a-f]+)\s*~\s*\n\s*(?://|--)\s*0x[0-9a-f]+\s*:\s*Memory '(\w+)' \((\d+) \* (\d+)b\)",
    re.MULTILINE | re.IGNORECASE,
)
_OF = re.compile(r"(?:Data|Control) signal of (\w+)", re.IGNORECASE)
_SLICE = re.compile(r"\w+\[(?:\d+:)?(\d+)\]")  # its lowest bit
_CONSTANT = re.compile(
    r"\bADDR_(\w+)\s*=\s*\d+'h([0-9a-f]+)|\bADDR_(\w+)\s*:[^:;]*:=\s*(?:16#|x\")([0-9a-f]+)", re.IGNORECASE
)
_MACRO = re.compile(r"^\s*#\s*define\s+X\w+?_ADDR_(\w+)\s+(0x[0-9a-f]+|\d+)", re.MULTILINE | re.IGNORECASE)
_CONTROL = {"ap_start": "start", "ap_done": "done", "ap_idle": "idle", "ap_ready": "ready", "ap_continue": "continue"}
_INTERRUPTS = (("global interrupt enable", "gie"), ("interrupt enable", "ier"), ("interrupt status", "isr"))
_READING = {
    "COR": "reading clears it",
    "TOW": "writing 1 toggles it",
    "COH": "cleared by the handshake",
    "SC": "clears itself",
}
_VOLATILE = ("ap_ctrl", "isr")


def is_hls(path: Path) -> bool:
    """Whether a file has the registers of an HLS module, by its name."""
    return bool(HDL.match(path.name) or HEADER.match(path.name))


def hls_interface(path: Path, top: str) -> str:
    """The interface of a module whose registers are in a ``<top>_<bundle>_s_axi`` file."""
    return "s_axi_" + path.name[: path.name.lower().rindex("_s_axi.")].removeprefix(f"{top}_")


def hls_items(path: Path) -> list[Item]:
    """The registers of one file, and its arrays as memories. Arguments of more than 32 bits have a register a word.

    Raises BuildError where the comment and the constants of the file disagree.
    """
    text = path.read_text(encoding="utf-8", errors="replace")
    listed = {item.name: item for item in _listed(text)}
    stated = dict(_constants(text))
    wrong = [
        f"{name} is at {item.offset:#x} in the comment, at {stated[name]:#x} in the constants"
        for name, item in listed.items()
        if stated.get(name, item.offset) != item.offset
    ]
    if wrong:
        raise BuildError(f"{path}: {'; '.join(wrong)}")
    bare = [RegisterInfo(name, offset, 32, volatile=name in _VOLATILE) for name, offset in stated.items()]
    return [*(listed.values() if listed else bare), *_arrays(text)]


def _arrays(text: str) -> Iterator[MemoryInfo]:
    """The arrays on a bus, as HLS packs elements into words; those beyond 64 bits are left out."""
    for at, name, count, bits in _ARRAY.findall(text):
        offset, length, width = int(at, 16), int(count), int(bits)
        item = next((size for size in (8, 16, 32, 64) if width <= size), 0)
        whole = length * item % 32 == 0
        doc = "" if width == item else f"elements of {width} bits"
        if item:
            yield MemoryInfo(name, offset, length * item // 8, "", item, (length,) if whole else None, doc)


def differences(ours: Mapping[str, Register], theirs: Mapping[str, Register]) -> list[str]:
    """What two descriptions of a module's registers say differently of a register that both have."""
    return [
        f"{name} is at {ours[name].offset:#x} and at {theirs[name].offset:#x}"
        for name in ours
        if name in theirs and ours[name].offset != theirs[name].offset
    ]


def _listed(text: str) -> Iterator[RegisterInfo]:
    """The registers of the comment; reserved words and memories are none."""
    found: list[tuple[int, str, list[re.Match[str]]]] = []
    for line in text.splitlines():
        if head := _REGISTER.match(line):
            found.append((int(head[1], 16), head[2], []))
        elif _MEMORY.match(line):
            found.append((0, "memory", []))
        elif found and (part := _FIELD.match(line)):
            found[-1][2].append(part)
    counts = Counter(of[1] for _, title, _ in found if (of := _OF.match(title)) and title.lower().startswith("data"))
    for offset, title, parts in found:
        if name := _name(title, parts, counts):
            yield _register(name, offset, title, parts)


def _name(title: str, parts: list[re.Match[str]], counts: Mapping[str, int]) -> str:
    """Name a register as its constant is named, in lower case; empty for what is no register."""
    lower = title.lower()
    if lower.startswith("control signals"):
        return "ap_ctrl"
    of = _OF.match(title)
    if of is None:
        return next((name for words, name in _INTERRUPTS if words in lower), "")
    if lower.startswith("control"):
        return f"{of[1]}_ctrl".lower()
    place = _SLICE.match(parts[0][3]) if parts else None
    word = int(place[1]) // 32 if place else 0
    return (f"{of[1]}_{word}" if counts[of[1]] > 1 else of[1]).lower()


def _register(name: str, offset: int, title: str, parts: list[re.Match[str]]) -> RegisterInfo:
    found = re.search(r"\(([^()]*)\)\s*$", title)
    whole = found[1] if found else ""
    said = {_said(part[4] or whole)[0] for part in parts} or {_said(whole)[0]}
    single = len(parts) == 1 and _SLICE.match(parts[0][3])
    fields = () if single else tuple(_fields(parts, whole))
    plain = "" if _OF.match(title) else re.sub(r"\s*\([^()]*\)\s*$", "", title)
    doc = "; ".join(filter(None, (plain, _said(whole)[3])))
    idle = sum(1 << part.lsb for part in fields if part.name == "idle")  # the only one that is 1 after a reset
    reset = idle if name == "ap_ctrl" else None
    return RegisterInfo(
        name, offset, 32, said.pop() if len(said) == 1 else "", reset, fields, doc, volatile=name in _VOLATILE
    )


def _said(words: str) -> tuple[str, str, str, str]:
    """A comment's ``Read/Write/COR`` as access, what a write does, what a read does, and the same in words."""
    parts = {word.strip().upper() for word in words.split("/")}
    reads, writes = bool(parts & {"R", "READ"}), bool(parts & {"W", "WRITE", "TOW"})
    access = {(True, False): "read-only", (False, True): "write-only"}.get((reads, writes), "read-write")
    write = "oneToToggle" if "TOW" in parts else "oneToSet" if writes and parts & {"COH", "SC"} else ""
    more = "; ".join(text for word, text in _READING.items() if word in parts)
    return access, write, "clear" if "COR" in parts else "", more


def _fields(parts: Iterable[re.Match[str]], whole: str) -> Iterator[RegisterField]:
    """The named bits; `whole`: what the comment says of all of them."""
    for part in parts:
        high, low, what = int(part[1]), int(part[2] or part[1]), part[3]
        channel = re.match(r"Channel \d+ \((\w+)\)|enable (\w+) interrupt|(\w+)(?: interrupt)?", what, re.IGNORECASE)
        word = next((text for text in channel.groups() if text), "") if channel else ""
        name = _CONTROL.get(word.lower(), re.sub(r"\W+", "_", word).lower())
        if not name or name in ("others", "reserved"):
            continue
        name = "enable" if what.lower().startswith("global") else name
        access, write, read, _ = _said(part[4] or whole)
        doc = _said(part[4] or "")[3]
        yield RegisterField(name, min(high, low), abs(high - low) + 1, access, write, read, doc=doc)


def _constants(text: str) -> Iterator[tuple[str, int]]:
    """``ADDR_<NAME>_DATA_0`` of the HDL, ``X…_ADDR_<NAME>_DATA`` of the header, as the names above."""
    raw = [(a or c, int(b or d, 16)) for a, b, c, d in _CONSTANT.findall(text)]
    raw += [(name, int(value, 0)) for name, value in _MACRO.findall(text)]
    plain = [(name.lower(), offset) for name, offset in raw if not name.upper().endswith(("_BASE", "_HIGH"))]
    several = {re.sub(r"_data_\d+$", "", name) for name, _ in plain if re.search(r"_data_[1-9]\d*$", name)}
    for name, offset in plain:
        base, _, word = name.rpartition("_data_")
        if base and word.isdigit():
            yield (f"{base}_{word}" if base in several else base), offset
        else:
            yield name.removesuffix("_data"), offset
