# SPDX-License-Identifier: Apache-2.0
"""Progress of a load for people: a bar in a notebook, or on a terminal."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from types import TracebackType
from typing import Any, TextIO

from cm.wire.messages import notebook
from cm.wire.messages.status import Progress

OnProgress = Callable[[Progress], None]
_AT_ONCE = 0.3  # seconds: shorter loads need no bar


class TextBar:
    """A progress bar on stderr, drawn only if that is a terminal; a context manager.

    with TextBar("loading") as bar:
        bar.update(0.5, "prr0")
    """

    def __init__(self, label: str, stream: TextIO | None = None) -> None:
        self._label = label
        self._stream = sys.stderr if stream is None else stream
        self._visible = self._stream.isatty()
        self._drawn = ""

    def update(self, fraction: float, note: str = "") -> None:
        """Show `fraction` (clipped to 0 to 1) and a word about what is being done."""
        if not self._visible:
            return
        import shutil  # half a MiB, needed only for a progress bar

        line = bar(self._label, fraction, note, shutil.get_terminal_size().columns - 1)
        if line != self._drawn:
            self._stream.write("\r" + line.ljust(len(self._drawn)))
            self._stream.flush()
            self._drawn = line

    def __enter__(self) -> TextBar:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._drawn:  # leave the line clean for what comes next
            self._stream.write("\r" + " " * len(self._drawn) + "\r")
            self._stream.flush()


def bar(label: str, fraction: float, note: str, columns: int) -> str:
    """One line such as ``loading [#####     ]  50 % prr0``, at most `columns` wide."""
    fraction = min(max(fraction, 0.0), 1.0)
    tail = f" {round(100 * fraction):3d} %" + (f" {note}" if note else "")
    width = min(40, columns - len(label) - len(tail) - 3)
    if width < 5:
        return (label + tail)[:columns]
    done = round(width * fraction)
    return f"{label} [{'#' * done}{' ' * (width - done)}]{tail}"


class NotebookBar(TextBar):
    """The same in the output of a notebook's cell, removed when the load has ended.

    A load that is over at once draws none, because a loop of loads would leave an empty output for each.
    """

    def __init__(self, label: str, display: Callable[..., Any], clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__(label)
        self._display, self._clock = display, clock
        self._begin = clock() + _AT_ONCE
        self._shown: Any = None

    def update(self, fraction: float, note: str = "") -> None:
        """As `TextBar.update`."""
        text = _Html(notebook.progress(fraction, f"{self._label} {note}"))
        if self._shown is not None:
            self._shown.update(text)
        elif self._clock() >= self._begin:
            self._shown = self._display(text, display_id=True)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._shown is not None:
            self._shown.update(_Html(""))


class _Html:
    """Text for a notebook's cell."""

    def __init__(self, text: str) -> None:
        self._text = text

    def _repr_html_(self) -> str:
        return self._text

    def __repr__(self) -> str:
        return ""


def ipython_shell() -> Any:
    """The session of IPython that this process runs; None where it is none."""
    ipython = sys.modules.get("IPython")
    return ipython.get_ipython() if ipython is not None else None


def notebook_display() -> Callable[..., Any] | None:
    """IPython's `display` if this process is a notebook's kernel, where it is imported already."""
    return sys.modules["IPython"].display.display if hasattr(ipython_shell(), "kernel") else None


class Shown:
    """The display of a load's progress, as `load(progress=)` asks: a context manager around the load.

    A function is called with each `Progress`. None draws a bar in a notebook, True on a terminal too, False nowhere.
    """

    def __init__(self, progress: OnProgress | bool | None, config: str, mode: str) -> None:
        self._bar: TextBar | None = None
        self.tell: OnProgress | None = None  # None: nothing is shown
        if callable(progress):
            self.tell = progress
        elif progress is not False:
            self._bar = _bar("/".join(str(part) for part in (config, mode) if part) or "load", progress)
            self.tell = self._draw if self._bar is not None else None

    def _draw(self, progress: Progress) -> None:
        if self._bar is not None:
            self._bar.update(progress.fraction, f"{progress.step} {progress.subject}")

    def __enter__(self) -> Shown:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.__exit__(kind, error, trace)


def _bar(label: str, wanted: bool | None) -> TextBar | None:
    display = notebook_display()
    if display is not None:
        return NotebookBar(label, display)
    return TextBar(label) if wanted else None
