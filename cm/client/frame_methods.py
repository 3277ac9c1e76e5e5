# SPDX-License-Identifier: Apache-2.0
"""The methods of numpy's arrays that look at an array's bytes: those of a frame that was given back must not."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar

import numpy as np

_Kind = TypeVar("_Kind", bound=type)
_LOOK = (
    "__complex__", "__contains__", "__copy__", "__deepcopy__", "__float__", "__index__", "__int__", "all", "any",
    "argmax", "argmin", "argpartition", "argsort", "astype", "byteswap", "choose", "clip", "compress", "conj",
    "conjugate", "cumprod", "cumsum", "diagonal", "dot", "dump", "dumps", "flatten", "getfield", "item", "max", "mean",
    "min", "nonzero", "prod", "ravel", "repeat", "reshape", "round", "searchsorted", "squeeze", "std", "sum",
    "swapaxes", "take", "tofile", "tolist", "trace", "transpose", "var", "view",
)  # fmt: skip


def checked(kind: _Kind) -> _Kind:
    """A class of arrays whose methods call its `_check` first.

    What C takes of an array without asking it cannot be checked: its buffer, and `numpy.asarray`.
    """
    for name in _LOOK:
        setattr(kind, name, _checking(getattr(np.ndarray, name)))
    return kind


def _checking(method: Callable[..., Any]) -> Callable[..., Any]:
    @wraps(method)
    def call(array: Any, *args: Any, **kwargs: Any) -> Any:
        array._check()
        return method(array, *args, **kwargs)

    return call
