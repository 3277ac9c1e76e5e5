# SPDX-License-Identifier: Apache-2.0
"""What the bits of a register do when it is accessed, and so what a write of some of them writes to the others.

The names are those of UVM (IEEE 1800.2, `uvm_reg_field`), in lower case. The manager and mapped windows ask the same
function, so that a field is written in the same way by both.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import NamedTuple

_KEEP, _NONE = 2, 3


class Kind(NamedTuple):
    """`idle`: which bits written change nothing: 0s, 1s, those that are there (`_KEEP`), or none (`_NONE`)."""

    readable: bool = True
    writable: bool = True
    idle: int = _KEEP
    read_changes: bool = False


KINDS: Mapping[str, Kind] = MappingProxyType(
    {
        "rw": Kind(),
        "ro": Kind(writable=False, idle=0),
        "wo": Kind(readable=False),
        "rc": Kind(writable=False, idle=0, read_changes=True),
        "rs": Kind(writable=False, idle=0, read_changes=True),
        "wrc": Kind(read_changes=True),
        "wrs": Kind(read_changes=True),
        "wc": Kind(idle=_NONE),
        "ws": Kind(idle=_NONE),
        **dict.fromkeys(("w1c", "w1s", "w1t"), Kind(idle=0)),
        **dict.fromkeys(("w0c", "w0s", "w0t"), Kind(idle=1)),
        **dict.fromkeys(("w1src", "w1crs"), Kind(idle=0, read_changes=True)),
        **dict.fromkeys(("w0src", "w0crs"), Kind(idle=1, read_changes=True)),
        **dict.fromkeys(("wsrc", "wcrs"), Kind(idle=_NONE, read_changes=True)),
    }
)


class Rest(NamedTuple):
    """What a write of some bits writes to the others; bits of none of the masks are written as 0.

    `ones` are written as 1, `read` as they are read, `last` as they were last written: these are not to be read, and
    `unread` names the fields in them. `changed` names the fields that any write changes.
    """

    ones: int = 0
    read: int = 0
    last: int = 0
    unread: tuple[str, ...] = ()
    changed: tuple[str, ...] = ()


def rest_of(register: tuple[str, int], fields: Iterable[tuple[str, int, str]], mask: int) -> Rest:
    """What a write of the bits in `mask` writes to the others.

    `register` is its access and its width in bits; `fields` are the name, the mask in place, and the access of each.
    """
    access, width = register
    listed = list(fields)
    ones = read = last = 0
    unread: list[str] = []
    changed: list[str] = []
    unnamed = ((1 << width) - 1) & ~mask
    for name, bits, does in listed:
        unnamed &= ~bits
        if not (others := bits & ~mask):
            continue
        kind = KINDS[does]
        if kind.idle == 1:
            ones |= others
        elif kind.idle == _NONE:
            changed.append(name)
        elif kind.idle == _KEEP:
            if not kind.readable:
                last |= others
                unread.append(name)
            else:
                read |= others
    own = KINDS[access]
    read |= unnamed if own.idle == _KEEP else 0
    if not own.readable or any(KINDS[does].read_changes for _, _, does in listed):
        unread += [name for name, bits, _ in listed if bits & read]
        last, read = last | read, 0
    return Rest(ones, read, last, tuple(unread), tuple(changed))


def must_not_be_read(access: str, fields: Iterable[str]) -> str:
    """Why a register is not read when a field of it is written: words that follow its name; empty if it may be."""
    if not KINDS[access].readable:
        return "is write-only"
    changing = next((does for does in fields if KINDS[does].read_changes), None)
    if changing is not None:
        return f"has a field that reading {'sets' if changing.endswith('rs') else 'clears'}"
    return "has a write-only field"


def changed_too(name: str, register: str, rest: Rest) -> str:
    """Why `name`, some bits of a register, cannot be written alone."""
    return f"{name!r}: any write of register {register!r} changes its field {rest.changed[0]}: write the whole"
