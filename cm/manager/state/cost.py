# SPDX-License-Identifier: Apache-2.0
"""What steps cost, as measured on this board, and the time-outs of loads that follow from it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType

from cm.schema.model import LoaderKind, Region

# Before anything was measured: facts of the ports (UG470 32 bit × 100 MHz; zynq-fpga over PCAP).
_NOMINAL = {LoaderKind.ICAP: 400e6, LoaderKind.FPGA_MANAGER: 145e6, LoaderKind.OVERLAY: 145e6}
_MARGIN = 20.0  # a load may take this many times what is expected before it counts as hung
_GRACE = 2.0  # seconds that any load may take
_WEIGHT = 0.25  # of the newest measurement in the running mean


@dataclass(frozen=True, slots=True)
class Throughput:
    """Running means of what was measured.

    `measured` are bytes per second of the ports, by kind of loader. `steps` are seconds by kind of step
    (`cm.manager.state.steps`) beside what a port takes for an image: reading files, the kernel's drivers, the
    record.
    """

    measured: Mapping[LoaderKind, float] = field(default_factory=lambda: MappingProxyType({}))
    steps: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))

    def rate(self, loader: LoaderKind) -> float:
        """Bytes per second to expect."""
        return self.measured.get(loader) or _NOMINAL[loader]

    def seconds(self, loader: LoaderKind, length: int) -> float:
        """Expected duration of a load of `length` bytes."""
        return length / self.rate(loader)

    def overhead(self, step: str) -> float:
        """Expected seconds of a kind of step beside the port; 0 before it was measured."""
        return self.steps.get(step, 0.0)

    def timeout(self, region: Region, length: int) -> float:
        """Seconds after which a load counts as hung: the schema's, else from size and throughput."""
        if region.timeout is not None:
            return region.timeout
        return _GRACE + _MARGIN * self.seconds(region.loader, length)

    def observed(self, loader: LoaderKind, length: int, seconds: float) -> Throughput:
        """With one more load."""
        if seconds <= 0 or length <= 0:
            return self
        rate = length / seconds
        mean = _mean(self.measured.get(loader, rate), rate)
        return replace(self, measured=MappingProxyType({**self.measured, loader: mean}))

    def took(self, step: str, seconds: float) -> Throughput:
        """With one more step, without what the port took in it."""
        mean = _mean(self.steps.get(step, seconds), seconds)
        return replace(self, steps=MappingProxyType({**self.steps, step: mean}))


def _mean(before: float, new: float) -> float:
    return before + _WEIGHT * (new - before)
