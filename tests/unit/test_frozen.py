# SPDX-License-Identifier: Apache-2.0
"""Our dataclasses do what the standard library's do, and compile nothing when a module is imported."""

from __future__ import annotations

import copy
import dataclasses
import pickle
import sys
from collections.abc import Callable
from typing import Any, ClassVar

import pytest

from cm.frozen import KW_ONLY, dataclass, field, names, replace


@dataclass(frozen=True, slots=True)
class Point:
    """Fields of every kind that the package uses."""

    x: int
    y: int = 2
    names: list[str] = field(default_factory=list)
    data: bytes = field(repr=False, default=b"")

    def __post_init__(self) -> None:
        if self.x < 0:
            raise ValueError(f"x is {self.x}")


@dataclass(frozen=True, slots=True)
class Named(Point):
    """One that inherits, and says itself what it is."""

    name: str = "n"

    def __repr__(self) -> str:
        return self.name


@dataclass(slots=True)
class Free:
    """One that may change; its mark is no field."""

    x: int
    seen: list[int] = field(default_factory=list)
    mark: ClassVar[str] = "m"


@dataclass(slots=True, eq=False)
class Alone:
    """One that is equal to itself only."""

    x: int


@dataclass(frozen=True, slots=True)
class One:
    """A single field."""

    value: object


@dataclass(frozen=True, slots=True)
class Nothing:
    """No field."""


def test_instances_are_made_shown_and_compared_as_elsewhere() -> None:
    assert repr(Point(1)) == "Point(x=1, y=2, names=[])"
    assert repr(Named(1)) == "n"
    assert (Point(1), One(1), Nothing()) == (Point(x=1, y=2), One(1), Nothing())
    assert Point(1) != Point(1, 3)
    assert Named(1) != Point(1)
    assert One(1) != 1
    assert {One("a"), One("a"), Nothing(), Nothing()} == {One("a"), Nothing()}
    assert Point(1).names is not Point(1).names


@pytest.mark.parametrize("wrong", [Point, lambda: Point(1, z=3), lambda: Nothing(1)])  # type: ignore[call-arg]
def test_wrong_arguments_are_refused_with_the_classs_name(wrong: Callable[[], object]) -> None:
    for _ in range(2):  # before and after __init__ was compiled
        with pytest.raises(TypeError, match=r"(Point|Nothing)\.__init__"):
            wrong()


def test_what_post_init_refuses_is_refused() -> None:
    with pytest.raises(ValueError, match="x is -1"):
        Named(-1)


def test_no_field_can_be_set_or_deleted() -> None:
    point: Any = Named(1)
    for change in (lambda: setattr(point, "x", 2), lambda: setattr(point, "z", 2), lambda: delattr(point, "x")):
        with pytest.raises(dataclasses.FrozenInstanceError):
            change()
    assert point.x == 1


def test_the_standard_librarys_functions_work() -> None:
    assert dataclasses.replace(Named(1), x=5, name="m") == Named(5, name="m")
    assert dataclasses.asdict(Point(1)) == {"x": 1, "y": 2, "names": [], "data": b""}
    assert [f.name for f in dataclasses.fields(Named)] == ["x", "y", "names", "data", "name"]
    assert (copy.copy(Point(1)), copy.deepcopy(Point(1)), pickle.loads(pickle.dumps(Point(1)))) == (Point(1),) * 3
    match Point(1, 7):
        case Point(1, y):
            assert y == 7


def test_our_own_functions_do_what_those_do() -> None:
    assert replace(Named(1), x=5, name="m") == Named(5, name="m")
    assert names(Named) == names(Named(1)) == tuple(f.name for f in dataclasses.fields(Named))
    with pytest.raises(TypeError, match="z"):
        replace(Point(1), z=3)


def test_defaults_are_seen_by_the_standard_library() -> None:
    x, y, named, data = dataclasses.fields(Point)
    assert (x.default, y.default, named.default_factory, data.repr) == (dataclasses.MISSING, 2, list, False)
    assert [f.type for f in (x, named)] == ["int", "list[str]"]
    assert dataclasses.is_dataclass(One)
    assert dataclasses.is_dataclass(Nothing())


def test_one_that_is_not_frozen_may_change() -> None:
    free = Free(1)
    free.x = 2
    free.seen.append(3)
    assert (free, repr(free), names(Free), Free.mark) == (Free(2, [3]), "Free(x=2, seen=[3])", ("x", "seen"), "m")
    assert copy.deepcopy(free) == pickle.loads(pickle.dumps(free)) == free
    with pytest.raises(TypeError, match="unhashable"):
        hash(free)
    with pytest.raises(AttributeError):
        free.z = 1  # type: ignore[attr-defined]


def test_one_without_equality_is_equal_to_itself() -> None:
    alone = Alone(1)
    assert alone == alone
    assert alone != Alone(1)
    assert {alone: 1}[alone] == 1


def test_other_kinds_are_the_standard_librarys() -> None:
    @dataclass(frozen=True)
    class Open:
        """One without slots."""

        x: int

    assert vars(Open(1)) == {"x": 1}
    assert replace(Open(2), x=1) == Open(1)


@pytest.mark.parametrize("default", [[], dataclasses.field(default=1)])
def test_what_instances_would_share_and_another_librarys_field_are_refused(default: Any) -> None:
    with pytest.raises(TypeError, match="is no default"):

        @dataclass(frozen=True, slots=True)
        class Wrong:
            """Its default is none."""

            x: Any = default


def test_no_method_is_compiled_before_the_first_instance() -> None:
    compiled = []
    sys.addaudithook(lambda event, _: compiled.append(event) if event == "compile" and watching else None)
    watching = True

    @dataclass(frozen=True, slots=True)
    class Late:
        """One that is never made, then is."""

        x: int

    before = len(compiled)
    Late(1), Late(2)
    watching = False
    assert (before, len(compiled) - before) == (0, 1)


def test_fields_below_kw_only_are_given_by_name() -> None:
    @dataclass(frozen=True, slots=True)
    class Named:
        first: int
        _: KW_ONLY
        second: int = 2
        third: int = 3

    assert Named(1, third=4) == replace(Named(1), third=4)
    assert repr(Named(1)).endswith("Named(first=1, second=2, third=3)")
    assert names(Named) == ("first", "second", "third")
    with pytest.raises(TypeError, match="takes 2 positional arguments but 3 were given"):
        Named(1, 2)  # type: ignore[misc]
