# SPDX-License-Identifier: Apache-2.0
"""Whether the machine slept: CLOCK_BOOTTIME continues during a suspend, CLOCK_MONOTONIC does not."""

from __future__ import annotations

import time
from collections.abc import Callable

_LEAST = 0.2  # seconds; the clocks are not read at one instant


def _asleep() -> float:
    """Seconds that the machine has slept since it was started."""
    return time.clock_gettime(time.CLOCK_BOOTTIME) - time.clock_gettime(time.CLOCK_MONOTONIC)


class Sleep:
    """Notices sleeps since it was made, or since the last that was `noted()`."""

    def __init__(self, asleep: Callable[[], float] = _asleep) -> None:
        self._asleep = asleep
        self._noted = asleep()

    def slept(self) -> bool:
        """Whether there was one."""
        return self._asleep() - self._noted > _LEAST

    def noted(self) -> None:
        """It was dealt with."""
        self._noted = self._asleep()
