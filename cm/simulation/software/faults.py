# SPDX-License-Identifier: Apache-2.0
"""Faults that were ordered by name, and which of them are due."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from cm.frozen import dataclass

# What can be injected, and what the target is.
KINDS: Mapping[str, str] = {
    "short_packet": "channel; value: bytes of the packet",
    "dma_error": "channel",
    "hang": "channel; until cleared",
    "drop_interrupt": "interrupt name",
    "icap_crc": "",
    "icap_id": "",
    "icap_hang": "",
    "icap_stall": "none; value: bytes that are taken before; until cleared",
    "icap_write_only": "none; until cleared",
    "overlay_error": "overlay name, or none for any",
    "probe_error": "node of an overlay, without its address",
    "fpga_manager_error": "",
    "register_stuck": "register name; until cleared",
    "clock_stuck": "clock name; until cleared",
    "gpio_stuck": "line as LABEL:LINE; until cleared",
}
STICKY = frozenset(kind for kind, what in KINDS.items() if what.endswith("until cleared"))
UNTIL_CLEARED = 0


def target_of(kind: str) -> str:
    """What the target of a fault of that kind is: channel, interrupt, …; "" if it has none."""
    what = KINDS.get(kind, "").split(";")[0].split(" ")[0]
    return "" if what == "none" else what


@dataclass(slots=True)
class Fault:
    """One order: `left` more times (0: until cleared), once so many loads have ended."""

    kind: str
    target: str
    value: int
    left: int
    loads: int = 0


class Faults:
    """The faults that wait to happen; a target "" stands for any."""

    def __init__(self) -> None:
        self._waiting: list[Fault] = []
        self.ordered: Callable[[], None] = lambda: None  # called when one is ordered
        self.loads: Callable[[], int] = lambda: 0  # how many have ended

    @property
    def waiting(self) -> bool:
        """Whether any are to happen."""
        return bool(self._waiting)

    def inject(self, kind: str, target: str = "", value: int = 0, count: int = 1, after: int = 0) -> None:
        """Order a fault, for when `after` more loads have ended; `count` 0 and the sticky kinds last until cleared."""
        if kind in STICKY:
            count = UNTIL_CLEARED
        self._waiting.append(Fault(kind, target, value, count, self.loads() + after if after else 0))
        self.ordered()

    def take(self, kind: str, target: str = "") -> Fault | None:
        """The fault that happens now, if one does; counts it."""
        if not self._waiting:
            return None
        for fault in self._waiting:
            if fault.kind == kind and fault.target in ("", target) and fault.loads <= self.loads():
                self._count(fault)
                return fault
        return None

    def clear(self, kind: str = "", target: str = "") -> None:
        """Forget those of a kind and target ("": all)."""
        self._waiting = [f for f in self._waiting if (kind and f.kind != kind) or (target and f.target != target)]

    def listing(self) -> list[str]:
        """The faults that wait, as they were ordered."""
        return [f"{f.kind} {f.target or '*'} value={f.value} left={f.left or 'until cleared'}" for f in self._waiting]

    def _count(self, fault: Fault) -> None:
        if fault.left == UNTIL_CLEARED:
            return
        fault.left -= 1
        if fault.left == 0:
            self._waiting.remove(fault)
