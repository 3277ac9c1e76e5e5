# SPDX-License-Identifier: Apache-2.0
"""Status, events, bodies of replies and some requests ↔ protobuf messages.

Data and message have fields of the same names, so that for most of them it is enough to say which two are twins.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from operator import attrgetter
from typing import Any, Generic, TypeVar

from google.protobuf.message import Message

from cm.wire import cm_pb2 as pb
from cm.wire.messages import _proto
from cm.wire.messages import status as st

_D = TypeVar("_D")
_M = TypeVar("_M", bound=Message)


class Twin(Generic[_D, _M]):
    """Frozen data, and the message with fields of the same names.

    A tuple is repeated there; what may be None need not be set, or is empty if it is text.
    """

    def __init__(
        self,
        kind: type[_D],
        message: type[_M],
        names: Sequence[str] | None = None,
        renamed: Mapping[str, str] | None = None,
        **parts: Any,
    ) -> None:
        """`names`: the fields that are written, if not all; `renamed`: those with other names in the message; `parts`:
        how those are written that are data themselves.
        """
        hints = {name: str(hint) for name, hint in kind.__annotations__.items()}
        self._kind, self._message, self.names = kind, message, tuple(hints if names is None else names)
        self.theirs = tuple([(renamed or {}).get(name, name) for name in self.names])
        self.parts = {name: part for name, part in parts.items() if name in self.names}
        self._lists = frozenset([name for name, hint in hints.items() if "tuple[" in hint])
        self._unset = frozenset([name for name, hint in hints.items() if "None" in hint and hint != "str | None"])
        special = [n in parts or n in self._lists or "None" in hints[n] for n in self.names]
        self._other = [
            (at, self.parts.get(n), n in self._lists, self.theirs[at] if n in self._unset else "")
            for at, n in enumerate(self.names)
            if special[at]
        ]
        self.values, self._read = _getter(self.names), _getter(self.theirs)
        fields: tuple[str, ...] = kind.__match_args__  # type: ignore[attr-defined]
        positional = fields[: fields.index(by_name[0])] if (by_name := getattr(kind, "__by_name__", ())) else fields
        in_order = [own == name for own, name in zip(positional, self.names, strict=False)]
        self._in_order = (*in_order, False).index(False)  # how many are given to the class without their names

    def to_pb(self, data: _D) -> _M:
        """The message."""
        return self._message(**self.given(data))

    def given(self, data: _D) -> dict[str, Any]:
        """What the message is made of; within it, protobuf makes the parts, without a copy of each."""
        given = dict(zip(self.theirs, self.values(data), strict=False))
        for name, part in self.parts.items():
            if value := given[name]:
                given[name] = [part.given(one) for one in value] if name in self._lists else part.given(value)
        return given

    def fits(self, name: str, value: object) -> bool:
        """Whether the message can hold a value of this field."""
        try:
            self._message(**{self.theirs[self.names.index(name)]: value})
        except (TypeError, ValueError, OverflowError):
            return False
        return True

    def from_pb(self, message: Any, **more: Any) -> _D:
        """The data, with `more` fields that are not in the message."""
        values, named = [*self._read(message)], self._in_order
        for at, part, is_list, unset in self._other:
            value = values[at]
            if is_list:
                values[at] = tuple([part.from_pb(one) for one in value] if part else value)
            elif unset and not message.HasField(unset):
                values[at] = None
            elif part:
                values[at] = part.from_pb(value)
            elif not unset:
                values[at] = value or None
        if named == len(self.names) and not more:
            return self._kind(*values[:named])
        return self._kind(*values[:named], **dict(zip(self.names[named:], values[named:], strict=False)), **more)


def _getter(names: Sequence[str]) -> Callable[[Any], tuple[Any, ...]]:
    """Of all of them, a tuple, also where they are fewer than two."""
    getter: Callable[[Any], tuple[Any, ...]] = attrgetter(*names, *("__class__", "__class__")[len(names) :])
    return getter


class _NamedValue:
    """A name of a value of a register's field, and the value."""

    @staticmethod
    def given(pair: tuple[str, int]) -> dict[str, Any]:
        return {"name": pair[0], "value": pair[1]}

    @staticmethod
    def from_pb(m: pb.FieldValue) -> tuple[str, int]:
        return m.name, m.value


class _PrMode:
    """Their numbers are those of the enum in cm.proto, which has them in this order."""

    _all = tuple(st.PrMode)
    given = {mode: number for number, mode in enumerate(_all)}.__getitem__

    @classmethod
    def from_pb(cls, number: int) -> st.PrMode:
        return cls._all[number] if 0 <= number < len(cls._all) else st.PrMode.ERROR


_WRITTEN: dict[str, Any] = {"PrMode": _PrMode, "tuple[str, int]": _NamedValue}  # by annotation: no message is theirs


def _parts(kind: type) -> dict[str, Any]:
    """How those fields of a class are written that are data themselves, by what its annotations say."""
    found: dict[str, Any] = {}
    for name, hint in kind.__annotations__.items():
        one = str(hint).removeprefix("tuple[").removesuffix(", ...]").removesuffix(" | None")
        if one in _WRITTEN:
            found[name] = _WRITTEN[one]
        elif one in _proto.__all__:
            found[name] = twin(getattr(_proto, one))
    return found


def message_of(kind: type) -> type[Message]:
    """The message that a class was made of."""
    found: type[Message] = getattr(pb, _proto.MESSAGES.get(kind.__name__, kind.__name__))
    return found


@cache
def twin(kind: type[_D]) -> Twin[_D, Any]:
    """Of a class that was made of a message: without the fields that this does not have."""
    message = message_of(kind)
    there = message.DESCRIPTOR.fields_by_name
    return Twin(kind, message, [name for name in kind.__annotations__ if name in there], **_parts(kind))


ERROR: Twin[st.ErrorInfo, Any] = twin(st.ErrorInfo)

_LASTING = ("configs", "streams", "sensors", "clocks", "version", "started_ns", "board")
_SELDOM = ("regions", "clients", "windows", "changes", "writes")
_OF_STATUS = _parts(st.Status)


class _KeptPart:
    """Some fields of a status, encoded; kept as long as what is in them stays."""

    def __init__(self, *names: str) -> None:
        self._twin = Twin(st.Status, pb.Status, names, **_OF_STATUS)
        self._last: tuple[Any, bytes] = (None, b"")

    def encoded(self, status: st.Status) -> bytes:
        value = self._twin.values(status)
        before, encoded = self._last
        if value != before:
            encoded = self._twin.to_pb(status).SerializeToString()
        self._last = value, encoded  # equal objects, too: the same ones are compared by identity the next time
        return encoded


class _StatusTwin(Twin[st.Status, pb.Status]):
    """A status is encoded in parts: protobuf reads messages that follow each other as one.

    The longest part is the same in the dozen statuses of one change of mode, and the next one in most of them.
    """

    def __init__(self) -> None:
        super().__init__(st.Status, pb.Status, **_OF_STATUS)
        self._lasting, self._seldom = _KeptPart(*_LASTING), _KeptPart(*_SELDOM)
        passing = [name for name in st.Status.__annotations__ if name not in _LASTING + _SELDOM]
        self._passing = Twin(st.Status, pb.Status, passing, **_OF_STATUS)

    def encoded(self, status: st.Status) -> bytes:
        """The bytes of the message."""
        passing = self._passing.to_pb(status).SerializeToString()
        return b"".join((self._lasting.encoded(status), self._seldom.encoded(status), passing))


STATUS = _StatusTwin()


def registers_to_pb(r: st.RegValues) -> pb.RegValues:
    message = pb.RegValues()
    registers_into(message, r)
    return message


class EncodedRegisters(st.RegValues):
    """Values of which `encoded` are the bytes: made some at a time where they are many."""

    encoded: bytes


def encoded_registers(r: st.RegValues, parts: Iterable[bytes]) -> st.RegValues:
    """The same values, of which these are the parts."""
    made = EncodedRegisters(*r)
    made.encoded = b"".join(parts)
    return made


def registers_into(message: pb.RegValues, r: st.RegValues) -> None:
    """Fill a message in place, in a third of the time that keyword arguments and a copy take."""
    message.config_name = r.config_name
    message.mode = r.mode
    message.generation = r.generation
    if type(r) is EncodedRegisters:
        message.MergeFromString(r.encoded)
        return
    for value in r.values:
        entry = message.values.add()
        entry.name = value.name
        entry.value = value.value
        if value.fields:
            entry.fields.update(value.fields)


def registers_from_pb(m: pb.RegValues) -> st.RegValues:
    values = [  # with the fields' values, which are a map there
        st.RegValue(v.name, v.value, tuple(sorted([(name, held[name]) for name in held])) if (held := v.fields) else ())
        for v in m.values
    ]
    return st.RegValues(tuple(values), m.config_name, m.mode, m.generation)


class _Registers:
    to_pb, from_pb = staticmethod(registers_to_pb), staticmethod(registers_from_pb)


_OURS = {theirs: ours for ours, theirs in _proto.MESSAGES.items()}


def kind_of(message: str) -> type:
    """The class that was made of a message, by its name."""
    kind: type = getattr(_proto, _OURS.get(message, message))
    return kind


class _Codecs(dict[type, Any]):
    def __missing__(self, kind: type) -> Any:
        self[kind] = twin(kind)
        return self[kind]


CODECS = _Codecs({st.Status: STATUS, st.RegValues: _Registers})  # what makes a message of data, and data of a message
