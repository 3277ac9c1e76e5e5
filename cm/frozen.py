# SPDX-License-Identifier: Apache-2.0
"""Frozen dataclasses that compile nothing when they are imported.

The standard library's ``dataclass(frozen=True, slots=True)`` compiles six methods of each class, which was more than a
third of the manager's start. Here `__init__` is compiled when the first instance is made, two are closures over the
fields, and the others are the same functions for all classes; all else (`fields`, `replace`, `asdict`, patterns) is
the standard library's. Checkers of types see its decorator.
"""

from __future__ import annotations

import dataclasses
from dataclasses import MISSING, FrozenInstanceError, fields
from operator import attrgetter
from types import FunctionType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dataclasses import dataclass as dataclass
else:

    def dataclass(**kind: bool) -> Any:
        """As `dataclasses.dataclass`, which makes all kinds but the frozen one with slots."""
        return _made if kind == {"frozen": True, "slots": True} else dataclasses.dataclass(**kind)


def _made(given: Any) -> Any:
    """The class with slots, and with the methods that it does not define itself."""
    own = set(vars(given))
    cls = dataclasses.dataclass(init=False, repr=False, eq=False, slots=True)(given)
    found = fields(cls)
    names = tuple(field.name for field in found)
    values = attrgetter(*names, *("__class__", "__class__")[len(names) :])  # a tuple, also of fewer than two fields

    def __init__(self: Any, *arguments: Any, **named: Any) -> None:
        made = _init(cls)
        cls.__init__ = made
        made(self, *arguments, **named)

    def __eq__(self: Any, other: object) -> Any:
        return values(self) == values(other) if other.__class__ is self.__class__ else NotImplemented

    def __hash__(self: Any) -> int:
        return hash(values(self))

    methods = {"__init__": __init__, "__eq__": __eq__, "__hash__": __hash__, **_METHODS}
    for name in methods.keys() - own:
        setattr(cls, name, methods[name])
    return cls


class _Alike:
    """What all classes share: closures for these, too, would take 0.2 MiB of a manager."""

    def __repr__(self: Any) -> str:
        shown = (f"{field.name}={getattr(self, field.name)!r}" for field in fields(self) if field.repr)
        return f"{type(self).__qualname__}({', '.join(shown)})"

    def __setattr__(self: Any, name: str, value: object) -> None:
        _refuse(self, "assign to", name)
        object.__setattr__(self, name, value)

    def __delattr__(self: Any, name: str) -> None:
        _refuse(self, "delete", name)
        object.__delattr__(self, name)

    def __getstate__(self: Any) -> list[Any]:
        return [getattr(self, field.name) for field in fields(self)]

    def __setstate__(self: Any, state: list[Any]) -> None:
        for field, value in zip(fields(self), state, strict=True):
            object.__setattr__(self, field.name, value)


_METHODS = {name: method for name, method in vars(_Alike).items() if isinstance(method, FunctionType)}


def _refuse(instance: Any, what: str, name: str) -> None:
    """Any name of such a class itself; of one that inherits without being one, only the fields."""
    if "__dataclass_fields__" in vars(type(instance)) or name in type(instance).__dataclass_fields__:
        raise FrozenInstanceError(f"cannot {what} field {name!r}")


def _init(cls: Any) -> Any:
    """Compile it: each field is set through its slot, which knows nothing of being frozen."""
    known: dict[str, Any] = {"__name__": cls.__module__, "absent": MISSING}
    parameters, body = [], []
    for number, field in enumerate(fields(cls)):
        name, value = field.name, field.name
        known[f"set{number}"] = getattr(cls, name).__set__
        if field.default is not MISSING:
            known[f"default{number}"] = field.default
            parameters.append(f"{name}=default{number}")
        elif field.default_factory is not MISSING:
            known[f"make{number}"] = field.default_factory
            parameters.append(f"{name}=absent")
            value = f"make{number}() if {name} is absent else {name}"
        else:
            parameters.append(name)
        body.append(f"set{number}(self, {value})")
    body += ["self.__post_init__()"] if hasattr(cls, "__post_init__") else []
    exec(f"def __init__(self, {', '.join(parameters)}):\n " + "\n ".join(body or ["pass"]), known)
    made = known["__init__"]
    made.__qualname__ = f"{cls.__qualname__}.__init__"
    return made
