# SPDX-License-Identifier: Apache-2.0
"""Dataclasses with slots, frozen or not, that compile nothing when they are imported.

The standard library's ``dataclass(frozen=True, slots=True)`` compiles six methods of each class, which was more than a
third of the manager's start, and its module imports five others, 1 MiB. Here `__init__` is compiled when the first
instance is made, two methods are closures over the fields, and the others are the same functions for all classes. The
standard library's own functions (`fields`, `asdict`, `is_dataclass`) work too: what they look for is made when they do.
Checkers of types see its decorator.
"""

from __future__ import annotations

from functools import partial
from operator import attrgetter
from types import FunctionType
from typing import TYPE_CHECKING, Any, NoReturn

_ABSENT: Any = object()


class _Field:
    """How a field gets its value if none is given, and whether it is shown."""

    __slots__ = ("default", "default_factory", "repr")

    def __init__(self, default: Any = _ABSENT, default_factory: Any = _ABSENT, repr: bool = True) -> None:  # noqa: A002
        self.default = default
        self.default_factory = default_factory
        self.repr = repr


_REQUIRED = _Field()

if TYPE_CHECKING:
    from dataclasses import KW_ONLY as KW_ONLY
    from dataclasses import dataclass as dataclass
    from dataclasses import field as field
    from dataclasses import replace as replace
else:

    class KW_ONLY:  # noqa: N801 (as in `dataclasses`)
        """``_: KW_ONLY``: the fields below are given by name."""

    def dataclass(*, frozen: bool = False, eq: bool = True, slots: bool = False) -> Any:
        """As `dataclasses.dataclass`, which makes those without slots."""
        if slots:
            return partial(_made, frozen=frozen, eq=eq)
        import dataclasses

        return dataclasses.dataclass(frozen=frozen, eq=eq)

    def field(**described: Any) -> Any:
        """As `dataclasses.field`."""
        return _Field(**described)

    def replace(instance: Any, /, **changes: Any) -> Any:
        """As `dataclasses.replace`, which looks at each field anew: a fifth of what Python did in a change of mode."""
        cls = instance.__class__
        try:
            values = cls.__values__
        except AttributeError:  # not made here
            import dataclasses

            return dataclasses.replace(instance, **changes)
        return cls(**{**dict(zip(cls.__match_args__, values(instance), strict=False)), **changes})


def names(cls: Any) -> tuple[str, ...]:
    """The fields of a class, or of an instance's."""
    found: tuple[str, ...] = cls.__match_args__
    return found


def _made(given: Any, frozen: bool, eq: bool) -> Any:
    """The class with slots, and with the methods that it does not define itself."""
    own = dict(vars(given))
    own["__annotations__"] = {name: kind for name, kind in given.__annotations__.items() if name != "_"}
    mine = [name for name, kind in own["__annotations__"].items() if "ClassVar" not in str(kind)]
    given_by_name = [*given.__annotations__].index("_") if "_" in given.__annotations__ else len(mine)
    new = {name: _described(own.pop(name, _REQUIRED)) for name in mine}
    known = _inherited(given) | new
    values = attrgetter(*known, *("__class__", "__class__")[len(known) :])  # a tuple, also of fewer than two fields

    def __init__(self: Any, *arguments: Any, **named: Any) -> None:
        made = _init(cls)
        cls.__init__ = made
        made(self, *arguments, **named)

    def __eq__(self: Any, other: object) -> Any:
        return values(self) == values(other) if other.__class__ is self.__class__ else NotImplemented

    def __hash__(self: Any) -> int:
        return hash(values(self))

    methods = {"__init__": __init__, "__repr__": _shown, "__match_args__": tuple(known), **_LOOKED_FOR}
    methods |= {"__eq__": __eq__} if eq else {}
    methods |= {"__hash__": __hash__} if eq and frozen else {}
    methods |= _FROZEN if frozen else {}
    apart = {
        "__fields__": known,
        "__by_name__": tuple(new)[given_by_name:][:1],
        "__slots__": tuple(new),
        "__qualname__": given.__qualname__,
        "__values__": values,
    }
    for name in ("__dict__", "__weakref__"):
        own.pop(name, None)
    cls = type(given)(given.__name__, given.__bases__, methods | own | apart)
    return cls


def _described(value: Any) -> _Field:
    if isinstance(value, _Field):
        return value
    if type(value).__module__ == "dataclasses" or type(value).__hash__ is None:
        raise TypeError(f"{value!r} is no default: a field of cm.frozen, with a factory, may be one")
    return _Field(value)


def _inherited(cls: Any) -> dict[str, _Field]:
    found: dict[str, _Field] = {}
    for base in reversed(cls.__mro__[1:]):
        found |= vars(base).get("__fields__", {})
    return found


def _shown(self: Any) -> str:
    shown = (f"{name}={getattr(self, name)!r}" for name, one in self.__fields__.items() if one.repr)
    return f"{type(self).__qualname__}({', '.join(shown)})"


class _Frozen:
    """What all frozen classes share: closures for these, too, would take 0.2 MiB of a manager."""

    def __setattr__(self: Any, name: str, value: object) -> None:
        _refuse(self, "assign to", name)
        object.__setattr__(self, name, value)

    def __delattr__(self: Any, name: str) -> None:
        _refuse(self, "delete", name)
        object.__delattr__(self, name)

    def __getstate__(self: Any) -> list[Any]:
        return [getattr(self, name) for name in self.__fields__]

    def __setstate__(self: Any, state: list[Any]) -> None:
        for name, value in zip(self.__fields__, state, strict=True):
            object.__setattr__(self, name, value)


_FROZEN = {name: method for name, method in vars(_Frozen).items() if isinstance(method, FunctionType)}


def _refuse(instance: Any, what: str, name: str) -> None:
    """Any name of such a class itself; of one that inherits without being one, only the fields."""
    if "__fields__" in vars(type(instance)) or name in instance.__fields__:
        _refused(f"cannot {what} field {name!r}")


def _refused(sentence: str) -> NoReturn:
    from dataclasses import FrozenInstanceError

    raise FrozenInstanceError(sentence)


class _LookedFor:
    """An attribute by which the standard library's functions know a dataclass."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __get__(self, instance: object, cls: Any) -> Any:
        from dataclasses import field as described
        from dataclasses import make_dataclass

        kinds: dict[str, Any] = {}
        for base in reversed(cls.__mro__):
            kinds |= getattr(base, "__annotations__", {})
        fields = []
        for name, one in cls.__fields__.items():
            said = {key: getattr(one, key) for key in one.__slots__}
            given = {key: value for key, value in said.items() if value is not _ABSENT}
            fields.append((name, kinds[name], described(**given)))
        made = make_dataclass(cls.__name__, fields, init=False, repr=False, eq=False)
        for name in _LOOKED_FOR:
            setattr(cls, name, getattr(made, name))
        return getattr(cls, self._name)


_LOOKED_FOR = {name: _LookedFor(name) for name in ("__dataclass_fields__", "__dataclass_params__")}


def _init(cls: Any) -> Any:
    """Compile it: each field is set through its slot, which knows nothing of being frozen."""
    known: dict[str, Any] = {"__name__": cls.__module__, "absent": _ABSENT}
    parameters, body = [], []
    for number, (name, one) in enumerate(cls.__fields__.items()):
        value = name
        parameters += ["*"] if name in cls.__by_name__ else []
        known[f"set{number}"] = getattr(cls, name).__set__
        if one.default is not _ABSENT:
            known[f"default{number}"] = one.default
            parameters.append(f"{name}=default{number}")
        elif one.default_factory is not _ABSENT:
            known[f"make{number}"] = one.default_factory
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
