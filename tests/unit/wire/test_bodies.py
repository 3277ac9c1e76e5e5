# SPDX-License-Identifier: Apache-2.0
"""Bodies of replies: each survives the wire with all that is in it, and with nothing in it."""

from __future__ import annotations

from dataclasses import replace
from enum import Enum
from itertools import count
from typing import Any, get_args, get_origin, get_type_hints

import pytest

from cm.wire.encode import decode_event, decode_reply, encode_reply, encode_status
from cm.wire.fleet import decode_answer, encode_answer
from cm.wire.messages import fleet, status

KINDS = [kind for kind in get_args(status.Body) if kind not in (type(None), status.RegValues)]
_numbers = count(1)


def filled(kind: Any) -> Any:
    """A value of the kind in which no field is like another."""
    if kind is bool:
        return True
    if kind in (int, float):
        return kind(next(_numbers) % 1000)
    if kind is str:
        return f"text {next(_numbers)}"
    if isinstance(kind, type) and issubclass(kind, Enum):
        return list(kind)[-1]
    parts = [part for part in get_args(kind) if part is not type(None)]
    if get_origin(kind) is tuple:
        return tuple(filled(part) for part in (parts if parts[-1] is not Ellipsis else [parts[0]] * 2))
    if parts:  # or None
        return filled(parts[0])
    return kind(**{name: filled(hint) for name, hint in get_type_hints(kind).items()})


def empty(kind: Any) -> Any:
    """One whose fields without a default are 0 or empty."""
    blank = {int: 0, float: 0.0, str: "", bool: False}
    hints = get_type_hints(kind)
    given = {name: blank.get(hint, () if get_origin(hint) is tuple else None) for name, hint in hints.items()}
    return kind(
        **{name: value for name, value in given.items() if value is not None or type(None) in get_args(hints[name])}
    )


@pytest.mark.parametrize("make", [filled, empty])
@pytest.mark.parametrize("kind", KINDS)
def test_a_body_is_unchanged_after_the_wire(kind: Any, make: Any) -> None:
    body = make(kind)
    if isinstance(body, status.FrameInfo):
        body = replace(body, lost=0)  # which each reader counts for itself
    assert decode_reply(encode_reply(b"topic", status.Reply(body, sequence=3))).body == body


@pytest.mark.parametrize("make", [filled, empty])
def test_a_published_status_is_the_same_as_the_one_before_it_or_not(make: Any) -> None:
    for told in (make(status.Status), filled(status.Status), make(status.Status)):
        assert decode_event(encode_status(told)) == told


@pytest.mark.parametrize("make", [filled, empty])
@pytest.mark.parametrize("kind", [fleet.FleetState, fleet.BundleState, status.ErrorInfo])
def test_an_answer_of_a_bridge_is_unchanged_after_the_wire(kind: Any, make: Any) -> None:
    body = make(kind)
    assert decode_answer(encode_answer(body)) == body
