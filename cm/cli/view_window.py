# SPDX-License-Identifier: Apache-2.0
"""A window with the newest frame, by Tk: Python's own, if it was built with it (Debian: python3-tk)."""

from __future__ import annotations

import tkinter
from typing import Any

import numpy as np
import numpy.typing as npt

from cm.client.rendering import coloured, picture

_SIGNAL = (1024, 384)


class Window:
    """It fits the picture to its size; q, Escape and its own button close it.

    Raises tkinter.TclError where there is no display.
    """

    def __init__(self, title: str) -> None:
        self._root = tkinter.Tk()
        self._root.title(title)
        self._root.configure(background="black")
        self._label = tkinter.Label(self._root, background="black", borderwidth=0)
        self._label.pack(expand=True, fill="both")
        self._says = tkinter.Label(self._root, anchor="w", background="black", foreground="#e7edea")
        self._says.pack(fill="x", side="bottom")
        self._image: tkinter.PhotoImage | None = None
        self.open = True
        for event in ("<q>", "<Escape>"):
            self._root.bind(event, lambda _: self.close())
        self._root.protocol("WM_DELETE_WINDOW", self.close)

    def draw(self, frame: npt.NDArray[Any], says: str) -> None:
        """Draw in place of the last frame."""
        pixels = coloured(picture(frame, *self._room(np.shape(frame)))[0])
        data = b"P6 %d %d 255\n" % (pixels.shape[1], pixels.shape[0]) + pixels.tobytes()
        self._image = tkinter.PhotoImage(data=data, format="PPM", master=self._root)
        self._label.configure(image=self._image)
        self.say(says)

    def _room(self, shape: tuple[int, ...]) -> tuple[int, int]:
        """Pixels for a frame: as many as it has itself, until the user resizes the window."""
        room = self._label.winfo_width(), self._label.winfo_height()
        if len(shape) < 2:
            return _SIGNAL
        if self._image is None or min(room) < 16:
            height, width = shape[-3:-1] if len(shape) > 2 and shape[-1] in (1, 3, 4) else shape[-2:]
            return min(width, self._root.winfo_screenwidth()), min(height, self._root.winfo_screenheight() - 80)
        return room

    def say(self, line: str) -> None:
        """The line under the picture."""
        self._says.configure(text=line)
        self.look()

    def look(self) -> bool:
        """Handle what the user did; returns whether the window is still open."""
        if self.open:
            self._root.update()
        return self.open

    def close(self) -> None:
        """Twice is fine."""
        if self.open:
            self.open = False
            self._root.destroy()
