# SPDX-License-Identifier: Apache-2.0
"""Frozen dataclasses that compile nothing when they are imported.

The standard library's ``dataclass(frozen=True, slots=True)`` compiles six methods of each class, which was more than a
third of the manager's start. Here `__init__` is compiled when the first instance is made, and the others are closures
over the fields; all else (`fields`, `replace`, `asdict`, patterns) is the standard library's. Checkers of types see
its decorator.
"""

from __future__ import annotations

import dataclasses
from dataclasses import MISSING, FrozenInstanceError, fields
from operator import attrgetter
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
    shown = tuple(field.name for field in found if field.repr)
    values = attrgetter(*names, *("__class__", "__class__")[len(names) :])  # a tuple, also of fewer than two fields

    def __init__(self: Any, *arguments: Any, **named: Any) -> None:
        made = _init(cls)
        cls.__init__ = made
        made(self, *arguments, **named)

    def __repr__(self: Any) -> str:
        return f"{type(self).__qualname__}({', '.join(f'{name}={getattr(self, name)!r}' for name in shown)})"

    def __eq__(self: Any, other: object) -> Any:
        return values(self) == values(other) if other.__class__ is self.__class__ else NotImplemented

    def __hash__(self: Any) -> int:
        return hash(values(self))

    def __setattr__(self: Any, name: str, value: object) -> None:
        if type(self) is cls or name in names:
            raise FrozenInstanceError(f"cannot assign to field {name!r}")
        super(cls, self).__setattr__(name, value)

    def __delattr__(self: Any, name: str) -> None:
        if type(self) is cls or name in names:
            raise FrozenInstanceError(f"cannot delete field {name!r}")
        super(cls, self).__delattr__(name)

    def __getstate__(self: Any) -> list[Any]:
        return [getattr(self, name) for name in names]

    def __setstate__(self: Any, state: list[Any]) -> None:
        for name, value in zip(names, state, strict=True):
            object.__setattr__(self, name, value)

    for method in (__init__, __repr__, __eq__, __hash__, __setattr__, __delattr__, __getstate__, __setstate__):
        if method.__name__ not in own:
            setattr(cls, method.__name__, method)
    return cls


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
