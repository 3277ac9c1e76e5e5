# SPDX-License-Identifier: Apache-2.0
"""What a load costs: throughput as measured on this board, and the time-outs that follow from it."""

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
    """Bytes per second by kind of loader: a running mean of what was measured."""

    measured: Mapping[LoaderKind, float] = field(default_factory=lambda: MappingProxyType({}))

    def rate(self, loader: LoaderKind) -> float:
        """Bytes per second to expect."""
        return self.measured.get(loader) or _NOMINAL[loader]

    def seconds(self, loader: LoaderKind, length: int) -> float:
        """Expected duration of a load of `length` bytes."""
        return length / self.rate(loader)

    def timeout(self, region: Region, length: int) -> float:
        """Seconds after which a load counts as hung: the schema's, else from size and throughput."""
        if region.timeout is not None:
            return region.timeout
        return _GRACE + _MARGIN * self.seconds(region.loader, length)

    def observed(self, loader: LoaderKind, length: int, seconds: float) -> Throughput:
        """With one more measurement."""
        if seconds <= 0 or length <= 0:
            return self
        rate = length / seconds
        before = self.measured.get(loader, rate)
        mean = before + _WEIGHT * (rate - before)
        return replace(self, measured=MappingProxyType({**self.measured, loader: mean}))
