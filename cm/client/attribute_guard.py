# SPDX-License-Identifier: Apache-2.0
"""Attributes that cannot be set by mistake: assigning to a misspelt name is an error."""

from __future__ import annotations

from difflib import get_close_matches
from typing import TYPE_CHECKING, Any, NoReturn


class Guarded:
    """Attributes can be set that begin with an underscore, that have a setter, or that the class itself sets.

    Python would take ``board.moed = "edge"`` for a new attribute, and nothing would happen to the board.
    """

    _advice: dict[str, str] = {}  # noqa: RUF012 (never changed)

    if not TYPE_CHECKING:  # to a type checker it would allow any name

        def __setattr__(self, name: str, value: Any) -> None:
            found = getattr(type(self), name, None)
            settable = isinstance(found, property) and found.fset is not None
            if name.startswith("_") or settable:
                object.__setattr__(self, name, value)
                return
            raise AttributeError(_refusal(self, name))

    def __reduce__(self) -> NoReturn:
        raise TypeError(
            "a board is a connection of this process and can be neither pickled nor copied: connect() there"
        )


def _refusal(guarded: Guarded, name: str) -> str:
    owner = type(guarded)
    if name in owner._advice:
        return owner._advice[name]
    public = [n for n in (*dir(owner), *owner.__annotations__) if not n.startswith("_")]
    if name in public:
        return f"{owner.__name__}.{name} cannot be set"
    close = get_close_matches(name, public, 1)
    return f"{owner.__name__} has no {name!r}{f': did you mean {close[0]!r}?' if close else ''}"
