# SPDX-License-Identifier: Apache-2.0
"""Python's collector of cyclic garbage, in a process whose threads all wait while it looks through everything.

It does so now and then: 15 to 30 ms for what a manager has made when it is ready, and 200 ms for a configuration of
24,000 registers. Such things stay. They have no cycles, so what they take is given back without a collector.
"""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager

_NEVER = 1 << 30  # collections of young objects until one of all


def keep() -> None:
    """What there is now is never looked through again."""
    gc.freeze()


@contextmanager
def keeping() -> Iterator[None]:
    """What is made meanwhile is to stay; young garbage is collected, but not all is looked through. One at a time."""
    gc.collect()  # little: most is kept already
    young, middle, old = gc.get_threshold()
    gc.set_threshold(young, middle, _NEVER)
    try:
        yield
        gc.collect(1)
        keep()
    finally:
        gc.set_threshold(young, middle, old)
