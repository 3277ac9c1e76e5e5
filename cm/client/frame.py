# SPDX-License-Identifier: Apache-2.0
"""A frame of a stream as a numpy array.

The methods of numpy's arrays that look at an array's bytes must not be called on one that was given back.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from cm.client.picture import has_rows, png
from cm.client.pixel_formats import AS_IT_IS, KNOWN, to_rgb
from cm.errors import InvalidRequest
from cm.frozen import replace
from cm.wire.messages.status import FrameInfo

_T = TypeVar("_T", bound=type)
_LOOK = (
    "__complex__", "__contains__", "__copy__", "__deepcopy__", "__float__", "__index__", "__int__", "all", "any",
    "argmax", "argmin", "argpartition", "argsort", "astype", "byteswap", "choose", "clip", "compress", "conj",
    "conjugate", "cumprod", "cumsum", "diagonal", "dot", "dump", "dumps", "flatten", "getfield", "item", "max", "mean",
    "min", "nonzero", "prod", "ravel", "repeat", "reshape", "round", "searchsorted", "squeeze", "std", "sum",
    "swapaxes", "take", "tofile", "tolist", "trace", "transpose", "var", "view",
)  # fmt: skip


def checked(kind: _T) -> _T:
    """A class of arrays whose methods call its `_check` first.

    What C takes of an array without asking it cannot be checked: its buffer, and `numpy.asarray`; they are empty then.
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


NO_INFO = "a view of a frame has no info and no sequence of its own; ask the frame"


class Frame(np.ndarray[Any, np.dtype[Any]]):
    """A read-only array over the frame's memory, with `info`: sequence, time, mode.

    Slices and results of arithmetic are plain arrays without `info`; `copy()` makes one to keep.
    """

    _info: FrameInfo | None = None

    @property
    def info(self) -> FrameInfo:
        """What is known about the frame besides its bytes."""
        if self._info is None:
            raise AttributeError(NO_INFO)
        return self._info

    @property
    def sequence(self) -> int:
        """Number in the stream; a gap is a loss."""
        return self.info.sequence

    @property
    def timestamp_ns(self) -> int:
        """CLOCK_MONOTONIC of the manager's machine at the end of the transfer."""
        return self.info.timestamp_ns

    @property
    def generation(self) -> int:
        """Generation of the registers when this frame began (`registers.write(…).generation`); 0: unknown."""
        return self.info.generation

    def copy(self, order: Any = "C") -> npt.NDArray[Any]:
        """The content as a plain, writable array."""
        return np.array(self, order=order, copy=True, subok=False)

    def _repr_png_(self) -> bytes | None:
        """For notebooks: the frame as a picture, if it is one."""
        return png(self.copy()) if has_rows(np.asarray(self)) else None

    def release(self) -> None:
        """Give the memory back before the last reference to the frame is gone; does nothing if the frame is a copy."""

    def __array_wrap__(self, array: Any, context: Any = None, return_scalar: bool = False) -> Any:
        return array[()] if return_scalar else np.asarray(array)

    def __getitem__(self, key: Any) -> Any:
        return np.asarray(self)[key]

    def _is_view(self) -> bool:
        return self._info is None

    def __reduce__(self) -> Any:
        return np.asarray(self).__reduce__() if self._is_view() else (_framed, (self.copy(), self.info))


def frame_of(info: FrameInfo, payload: Any, raw: bool = False) -> Frame:
    """A payload as an array of the shape and dtype that stand beside it, in RGB where it has a format, unless `raw`.

    Raises InvalidRequest if they disagree.
    """
    try:
        array = np.frombuffer(payload, np.dtype(info.dtype)).reshape(info.shape)
    except (ValueError, TypeError) as error:
        raise InvalidRequest(
            f"frame {info.sequence} of {info.stream!r} does not fit {info.shape} {info.dtype}: {error}"
        ) from error
    return _framed(array, info) if raw or info.format in AS_IT_IS else in_rgb(array, info.format, info)


def in_rgb(pixels: npt.NDArray[Any], form: str, info: FrameInfo) -> Frame:
    """A frame in memory as one in RGB, which is a copy. Raises InvalidRequest for a format of a newer manager."""
    if form not in KNOWN:
        raise InvalidRequest(f"stream {info.stream!r}: pixels of {form!r} are not known here; raw=True reads them")
    found = to_rgb(pixels, form)
    return _framed(found, replace(info, shape=found.shape, format="rgb"))


def _framed(array: npt.NDArray[Any], info: FrameInfo) -> Frame:
    array.flags.writeable = False
    frame: Frame = array.view(Frame)
    frame._info = info
    return frame
