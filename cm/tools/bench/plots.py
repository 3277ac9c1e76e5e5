# SPDX-License-Identifier: Apache-2.0
"""The figures as PNG files."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from cm.tools.bench.peer import INSTALL, Unavailable
from cm.tools.bench.result import Result

_MIB = 2**20


def require() -> None:
    """Raise Unavailable where matplotlib is missing: before anything is measured, not after."""
    try:
        import matplotlib
    except ImportError as error:
        raise Unavailable(f"plots are {INSTALL}") from error
    matplotlib.use("Agg")


def draw(folder: Path, results: Sequence[Result]) -> list[Path]:
    """Draw the figures for which there are results; returns the files."""
    require()
    folder.mkdir(parents=True, exist_ok=True)
    drawn = []
    for result in results:
        figure = _FIGURES.get(result.name)
        if figure is not None and result.value is not None:
            path = folder / f"{result.name}.png"
            figure(result.details, path)
            drawn.append(path)
    return drawn


def _axes(title: str, x: str, y: str, width: float = 7.0) -> tuple[Any, Any]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, 4.2), dpi=120, layout="constrained")
    axes = figure.subplots()
    axes.set(title=title, xlabel=x, ylabel=y)
    axes.grid(True, alpha=0.3)
    return figure, axes


def _latency(details: Mapping[str, Any], path: Path) -> None:
    """Fig. 5: latency against payload, one line for each way."""
    figure, axes = _axes("Round trip against payload", "payload [bytes]", "median round trip [µs]", width=9.5)
    for name, points in details["series"].items():
        axes.plot([p["bytes"] for p in points], [p["median"] for p in points], marker="o", label=name)
    axes.set_xscale("log", base=2)
    axes.set_yscale("log")
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize="small")
    figure.savefig(path)


def _trips(details: Mapping[str, Any], path: Path) -> None:
    """Fig. 4: round trips PS–PL–PS by size of the image."""
    figure, axes = _axes("Round trips PS–PL–PS", "image [MiB]", "round trip [ms]")
    for name, points in details["series"].items():
        sizes, medians = [p["bytes"] / _MIB for p in points], [p["median"] / 1e3 for p in points]
        axes.plot(sizes, medians, marker="o", label=name)
    axes.set_ylim(bottom=0)
    axes.legend()
    figure.savefig(path)


def _split(details: Mapping[str, Any], path: Path) -> None:
    figure, axes = _axes("Change of mode, 8 MB partial at 400 MB/s", "median [ms]", "")
    parts = {name: value for name, value in details["split_ms"].items() if name not in ("total", "trigger")}
    axes.barh(list(parts), list(parts.values()))
    axes.invert_yaxis()
    figure.savefig(path)


_FIGURES: dict[str, Callable[[Mapping[str, Any], Path], None]] = {
    "fig4": _trips,
    "fig5": _latency,
    "reconfigure": _split,
}
