# SPDX-License-Identifier: Apache-2.0
"""Frozen classes of what the manager tells, made of the messages in cm.proto; setup.py writes them.

Most fields have the default that protobuf gives them. The comments in cm.proto stand in the classes.
"""

from __future__ import annotations

import re

NAMES = {f"{x}State": f"{x}Status" for x in ("Region", "Stream", "Clock", "Sensor", "Lease", "Client", "Window")}
NAMES |= {name: f"{name}Info" for name in ("Error", "Config", "Plan", "Frame", "Change", "Lease", "Upload")}
WITHOUT = {  # requests (`cm.wire.messages.requests`), and what needs no class
    "Reply", "ReadStatus", "ReadConfig", "WriteConfig", "File", "Region", "ReadReg", "RegWrite", "WriteReg",
    "DataConfig", "ReadData", "WriteData", "ReadIrq", "FieldValue", "FrameSeen", "FrameData",
}  # fmt: skip
TUPLES = {"RegionColumn", "RegValue", "RegValues", "WindowState"}  # made for many requests: in half the time
BASES = {"Status": "(shown.StatusText)", "Plan": "(shown.PlanText)"}
PAIRS = "tuple[tuple[str, int], ...] = ()"
FIELDS = {  # that are other ones in Python, or have another default there, or none are made of
    "Status.pr_mode": "PrMode = PrMode.IDLE",
    "RegionState.module": "str | None = None",
    "LeaseState.exclusive": "bool = True",
    "MemoryInfo.access": 'str = "rw"',
    "MemoryInfo.dtype": 'str = "uint32"',
    **dict.fromkeys(("StreamState.dtype", "Frame.dtype"), 'str = "uint8"'),
    "FieldInfo.values": PAIRS,
    **dict.fromkeys(("Lease.release", "Lease.pid", "Lease.number", "Upload.discard", "Status.labels", "Status.fleet")),
}
LOST = "    lost: int = 0  # frames between the reader's last one and this; `failed` then counts those among them\n"
SCALARS = {"string": 'str = ""', "bytes": 'bytes = b""', "bool": "bool = False", "map<string, uint64>": PAIRS}
SCALARS |= dict.fromkeys(("float", "double"), "float = 0.0") | dict.fromkeys(("uint32", "uint64", "sint64"), "int = 0")
HEAD = '''"""What release/message_classes.py makes of cm.proto."""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple

from cm.frozen import dataclass
from cm.wire.messages import shown'''
_MESSAGE = re.compile(r"((?:^//.*\n)*)^(?:message|enum) (\w+) \{\n((?: .*\n|\n)*)\}", re.MULTILINE)
_FIELD = re.compile(
    r"((?:^ +//.*\n)*)^ +(oneof \w+ \{ )?(repeated )?(\w+|map<\w+, \w+>) (\w+) = \d+;(?: \})?(?: +(//.*))?$",
    re.MULTILINE,
)


def source(proto: str) -> str:
    """The text of the module. Raises ValueError for what this does not know."""
    found = {name: (about, inside) for about, name, inside in _MESSAGE.findall(proto)}
    body = found["Reply"][1].partition("oneof body")[2]
    bodies = [_python(kind) for _, _, _, kind, _, _ in _FIELD.findall(body)]
    made = [_class(name, *found[name]) for name in found if name not in WITHOUT]
    named = [_python(name) for name in found if name not in WITHOUT]
    lines = [
        HEAD,
        f"__all__ = {named}",
        f"MESSAGES = { {ours: theirs for theirs, ours in NAMES.items()} }  # that have another name\n",
        *made,
        f"Body = {' | '.join(bodies)} | None  # of a reply\n",
    ]
    return "\n\n".join(lines)


def _class(name: str, about: str, inside: str) -> str:
    if not about:
        raise ValueError(f"message {name} says nothing of itself")
    said = re.sub(r"^// ?", "    ", about, flags=re.MULTILINE).strip()
    head = f'    """{said}"""\n\n' if "\n" not in said else f'    """{said}\n    """\n\n'
    if name == "PrMode":
        values = "".join(f'    {x} = "{x.lower()}"\n' for x in re.findall(r"PR_MODE_(\w+) = \d+;", inside))
        return f"class PrMode(str, Enum):\n{head}{values}"
    fields = _FIELD.findall(inside)
    if len(fields) != len(re.findall(r"^[^/\n]* = \d+\b", inside, re.MULTILINE)):
        raise ValueError(f"message {name} has lines that this does not know")
    lines = "".join(_field(name, *field) for field in fields) + LOST * (name == "Frame")
    if name in TUPLES:
        return f"class {_python(name)}(NamedTuple):\n{head}{lines}"
    return f"@dataclass(frozen=True, slots=True)\nclass {_python(name)}{BASES.get(name, '')}:\n{head}{lines}"


def _field(message: str, above: str, optional: str, repeated: str, kind: str, name: str, beside: str) -> str:
    scalar = SCALARS.get(kind)
    typed: str | None
    if (typed := FIELDS.get(f"{message}.{name}", "")) is None:
        return ""
    one = scalar.partition(" ")[0] if scalar else _python(kind)
    if not typed:
        typed = f"tuple[{one}, ...] = ()" if repeated else f"{one} | None = None" if optional or not scalar else scalar
    said = " ".join(re.findall(r"//\s*(.*)", above + beside))
    return f"    {name}: {typed}{f'  # {said}' if said else ''}\n"


def _python(name: str) -> str:
    return NAMES.get(name, name)
