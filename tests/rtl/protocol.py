# SPDX-License-Identifier: Apache-2.0
"""Protocol checks that watch an interface for a whole simulation (IHI 0022 A3.2, IHI 0051 2.2).

A handshake's source keeps VALID and its payload until READY, whatever the sink does; responses come
only for requests; a burst has as many beats as its address said.
"""

from __future__ import annotations

import logging
from collections import deque

import cocotb
from cocotb.triggers import RisingEdge

CHANNELS = {
    "aw": ("awaddr", "awlen", "awsize", "awburst", "awprot", "awid"),
    "w": ("wdata", "wstrb", "wlast"),
    "b": ("bresp", "bid"),
    "ar": ("araddr", "arlen", "arsize", "arburst", "arprot", "arid"),
    "r": ("rdata", "rresp", "rlast", "rid"),
}


def value(handle: object) -> str:
    """The bits of a signal, X and Z included."""
    return str(handle.value)


class Handshake:
    """Watches one channel: what was offered stays offered."""

    def __init__(
        self, dut: object, clock: object, reset: object, name: str, valid: str, ready: str, payload: list[str]
    ):
        self.name, self.beats = name, 0
        self.errors: list[str] = []
        self.taken: deque[dict[str, str]] = deque(maxlen=100_000)
        self._dut, self._clock, self._reset = dut, clock, reset
        self._valid, self._ready = getattr(dut, valid), getattr(dut, ready)
        self._payload = {signal: getattr(dut, signal) for signal in payload if hasattr(dut, signal)}
        cocotb.start_soon(self._watch())

    async def _watch(self) -> None:
        offered: dict[str, str] | None = None
        while True:
            await RisingEdge(self._clock)
            if value(self._reset) != "1":
                offered = None
                continue
            valid, ready = value(self._valid), value(self._ready)
            if valid not in "01" or (valid == "1" and ready not in "01"):
                self.errors.append(f"{self.name}: valid {valid}, ready {ready}")
                continue
            now = {signal: value(handle) for signal, handle in self._payload.items()} if valid == "1" else None
            if offered is not None and now != offered:
                self.errors.append(f"{self.name}: offered {offered}, then {now} before it was taken")
            offered = now if valid == "1" and ready == "0" else None
            if valid == "1" and ready == "1" and now is not None:
                self.beats += 1
                self.taken.append(now)


class AxiChecker:
    """All channels of an AXI4 or AXI4-Lite interface."""

    def __init__(self, dut: object, clock: object, reset: object, prefix: str) -> None:
        self.channels = {}
        for channel, signals in CHANNELS.items():
            names = [f"{prefix}_{signal}" for signal in signals]
            ready, valid = f"{prefix}_{channel}ready", f"{prefix}_{channel}valid"
            self.channels[channel] = Handshake(dut, clock, reset, f"{prefix} {channel.upper()}", valid, ready, names)
        self._prefix = prefix

    def check(self) -> None:
        """Raise AssertionError for everything that was wrong; requests and answers must balance."""
        errors = [error for channel in self.channels.values() for error in channel.errors]
        assert not errors, "\n".join(errors[:10])
        count = {name: channel.beats for name, channel in self.channels.items()}
        assert count["b"] == count["aw"], f"{self._prefix}: {count}"
        lengths = [int(beat.get(f"{self._prefix}_awlen", "0"), 2) + 1 for beat in self.channels["aw"].taken]
        assert count["w"] == sum(lengths), f"{self._prefix}: {count['w']} beats of data for {sum(lengths)}"
        lengths = [int(beat.get(f"{self._prefix}_arlen", "0"), 2) + 1 for beat in self.channels["ar"].taken]
        assert count["r"] == sum(lengths), f"{self._prefix}: {count['r']} beats read for {sum(lengths)}"
        last = f"{self._prefix}_wlast"
        if self.channels["w"].taken and last in self.channels["w"].taken[0]:
            self._check_last("w", last, "aw")
            self._check_last("r", f"{self._prefix}_rlast", "ar")

    def _check_last(self, channel: str, last: str, address: str) -> None:
        """LAST marks the last beat of each burst: bursts of one channel come in order here."""
        beats = iter(self.channels[channel].taken)
        for request in self.channels[address].taken:
            length = int(request.get(f"{self._prefix}_{address}len", "0"), 2) + 1
            marks = [next(beats)[last] for _ in range(length)]
            assert marks == ["0"] * (length - 1) + ["1"], f"{self._prefix} {channel}: {marks}"


def quiet() -> None:
    """The bus models log every transfer and every flush; only errors are of interest."""
    logging.getLogger("cocotb").setLevel(logging.ERROR)
    logging.getLogger("py.warnings").setLevel(logging.ERROR)  # cocotbext-axi uses names that cocotb 2 renames
