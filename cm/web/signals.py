# SPDX-License-Identifier: Apache-2.0
"""Signals as a browser draws them: over time, as a spectrum, or as points in the complex plane."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from cm.client.rendering import MOST, outline

COLUMNS = 1024  # of a signal over time: the least and the greatest value in each
_BINS = 1024  # of a spectrum
_BLOCKS = 16  # of a frame that a spectrum is the mean of, from its start
_POINTS = 2048  # in the complex plane
_PAIRS = 16  # rows of two numbers at least: fewer are a small picture
_FLOOR = -200.0  # dB of nothing
Array: TypeAlias = npt.NDArray[Any]
Drawn: TypeAlias = tuple[dict[str, Any], list[Array]]  # what the header says of it, and its values


def is_signal(values: Array) -> bool:
    """Whether a frame is a signal: one axis, or many rows of two numbers, which are I and Q."""
    return values.ndim < 2 or (values.ndim == 2 and values.shape[1] == 2 and len(values) >= _PAIRS)


def drawn(values: Array, view: str) -> Drawn:
    """A frame that `is_signal` and has values, as `view`: "", "spectrum" or "constellation"."""
    full = float(np.iinfo(values.dtype).max) if values.dtype.kind in "iu" else 1.0
    signal = np.atleast_1d(values)
    if signal.ndim == 2:
        signal = signal[:, 0] + 1j * signal[:, 1].astype(np.float64)
    if view == "spectrum":
        about, planes = _spectrum(_finite(signal), full)
    elif view == "constellation" and np.iscomplexobj(signal):
        about, planes = _constellation(_finite(signal))
    else:
        about, planes = _over_time(signal)
    return {"view": view, "length": len(signal), "complex": np.iscomplexobj(signal), **about}, planes


def _over_time(signal: Array) -> Drawn:
    """Of each line: the least value of each column, then the greatest."""
    lines = {"I": signal.real, "Q": signal.imag} if np.iscomplexobj(signal) else {"": signal}
    outlines = [outline(line, COLUMNS) for line in lines.values()]
    spans = [one.span for one in outlines]
    span = min(low for low, _ in spans), max(high for _, high in spans)
    planes = [part for one in outlines for part in (one.low, one.high)]
    return {"view": "", "lines": list(lines), "columns": len(planes[0]), "range": span}, planes


def _spectrum(signal: Array, full: float) -> Drawn:
    """Hann window, mean power of blocks, in dB of a tone of full scale; from `low` to `high` of the sample rate."""
    size = min(_BINS, len(signal))
    blocks = signal[: len(signal) // size * size].reshape(-1, size)[:_BLOCKS] / full
    window = np.hanning(size + 2)[1:-1]
    power = (np.abs(np.fft.fft(blocks * (window / window.sum()), axis=1)) ** 2).mean(axis=0)
    if np.iscomplexobj(signal):
        power, low = np.fft.fftshift(power), -(size // 2) / size
    else:
        power, low = power[: size // 2 + 1], 0.0
        power[1 : (size + 1) // 2] *= 4  # the other half of a real tone
    decibels = np.maximum(10 * np.log10(np.maximum(power, 1e-30)), _FLOOR)
    span = float(decibels.min()), float(decibels.max())
    return {"columns": len(decibels), "low": low, "high": low + len(decibels) / size, "range": span}, [decibels]


def _constellation(signal: Array) -> Drawn:
    """Samples from all over the frame: I, then Q."""
    points = signal[np.linspace(0, len(signal) - 1, min(len(signal), _POINTS)).astype(np.int64)]
    most = float(max(np.abs(points.real).max(), np.abs(points.imag).max()))
    return {"columns": len(points), "range": (-most, most)}, [points.real, points.imag]


def _finite(signal: Array) -> Array:
    """What can be squared, and held by a float32; a number that is none is 0."""
    if np.iscomplexobj(signal):
        return _finite(signal.real) + 1j * _finite(signal.imag)
    return np.clip(np.nan_to_num(signal.astype(np.float64), posinf=0.0, neginf=0.0), -MOST, MOST)
