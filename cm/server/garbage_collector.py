# SPDX-License-Identifier: Apache-2.0
"""Python's collector of garbage stops all threads while it searches all objects: what stays is left out of that."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager

_NEVER = 1 << 30  # collections of young objects until one of all


@contextmanager
def keeping() -> Iterator[None]:
    """For making objects that will stay: young garbage is collected, but not everything is searched. One at a time."""
    gc.collect()  # quick, since most objects are excluded already
    young, middle, old = gc.get_threshold()
    gc.set_threshold(young, middle, _NEVER)
    try:
        yield
        gc.collect(1)
        gc.freeze()
    finally:
        gc.set_threshold(young, middle, old)
