# SPDX-License-Identifier: Apache-2.0
"""After fork(): what a process has opened is its own. A child has copies of it, and must not use or end them.

A child that read a stream would take its parent's frames; one that let go of a frame would give back what its parent
looks at.
"""

from __future__ import annotations

import os
import weakref
from typing import Protocol


class Opened(Protocol):
    """Something open."""

    def disown(self) -> None:
        """This is a child: it belongs to the parent."""


_OPENED: weakref.WeakSet[Opened] = weakref.WeakSet()


def not_for_children(opened: Opened) -> None:
    """Have `opened.disown()` called in each child that is forked from here on, before anything else runs in it."""
    _OPENED.add(opened)


def _disown() -> None:
    for opened in tuple(_OPENED):
        opened.disown()


if hasattr(os, "register_at_fork"):  # not on Windows, which has no fork
    os.register_at_fork(after_in_child=_disown)
