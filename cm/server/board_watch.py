# SPDX-License-Identifier: Apache-2.0
"""Whether the board is there, and still the same one: it may go, be restarted, sleep, or be loaded by others.

A suspend shows as CLOCK_BOOTTIME going on while CLOCK_MONOTONIC does not.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable

from cm.device import DeviceGone
from cm.device.other_loads import OtherLoads
from cm.errors import CmError
from cm.manager.manager import Manager
from cm.server.interrupts import InterruptWatch
from cm.server.streams.running import Streams

_LOG = logging.getLogger("cm")
_LEAST = 0.2  # seconds; the clocks are not read at one instant


def _asleep() -> float:
    """Seconds that the machine has slept since it was started."""
    return time.clock_gettime(time.CLOCK_BOOTTIME) - time.clock_gettime(time.CLOCK_MONOTONIC)


class BoardWatch:
    """Compares boot ids now and then, and is told of errors. The loop's thread."""

    def __init__(
        self,
        boot_id: Callable[[], str],
        others: OtherLoads,
        manager: Manager,
        streams: Streams,
        interrupts: InterruptWatch,
        begin: Callable[[], None],
    ) -> None:
        """`begin` is called when a board that was started anew can be used."""
        self._boot_id = boot_id
        self._others = others
        self._manager = manager
        self._streams = streams
        self._interrupts = interrupts
        self._begin = begin
        self._slept = _asleep()  # as far as it was dealt with
        self._known = ""

    def begin(self) -> None:
        """Remember the board as it is now."""
        self._known = self._boot_id()
        self._others.begin()
        self._interrupts.watch(self._manager.loaded_config())
        self._begin()

    def notice_error(self, error: Exception) -> None:
        """A request met an error; if the board has gone, nothing is known of it any more."""
        if isinstance(error, DeviceGone):
            self._manager.board_lost(error)

    def poll(self) -> None:
        """Deal with a board that was restarted, that slept, or that others have loaded; called now and then."""
        self._check_restart()
        self._check_sleep()
        if not self._manager.changing:
            self._check_other_loads()

    def close(self) -> None:
        """Watch nothing any more."""
        self._others.close()

    def _check_restart(self) -> None:
        """A restarted board holds nothing of what is recorded."""
        boot_id = self._boot_id()
        if boot_id == self._known or not boot_id or self._manager.status().fpga_busy:
            return
        self._streams.close()
        self._interrupts.close()
        try:
            self._manager.board_restarted()
        except (CmError, OSError) as error:
            _LOG.info("the board is back but does not answer yet: %s", error)
            return
        self._known = boot_id
        self._others.begin()
        try:
            self._begin()
        except CmError as error:  # what the start asked for may have been removed since
            _LOG.error("the board was restarted, and nothing is loaded: %s", error)

    def _check_sleep(self) -> None:
        """While the machine slept, the PL may have been without power."""
        if _asleep() - self._slept <= _LEAST or self._manager.changing:
            return
        try:
            self._manager.board_slept()
        except (CmError, OSError) as error:
            _LOG.warning("after the machine's sleep: %s", error)
            return
        self._slept = _asleep()

    def _check_other_loads(self) -> None:
        """What other programs have loaded, or removed; what they do while a change runs is seen after it."""
        seen = self._others.look([overlay.name for overlay in self._manager.state.overlays])
        if (seen.loads or seen.removed) and self._boot_id() == self._known:  # else it is another board, seen to next
            who = self._others.who()
            _LOG.warning("another program: %s; %s", "; ".join((*seen.loads, *seen.removed)), who or "none is known")
            self._manager.board_taken(seen.loads, seen.removed, who)
