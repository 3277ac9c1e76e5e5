# SPDX-License-Identifier: Apache-2.0
"""Recognises clocks, resets and interrupts by common names."""

from __future__ import annotations

import re
from dataclasses import replace

from cm.design.hdl.model import Mode, Polarity, Port, PortDirection


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


_CAMEL = re.compile(r"(?<=[a-z0-9])(?=[A-Z])")
_CLOCK = re.compile(r"(?!sclk)(?:[a-z]{0,5}clk|[a-z]?clock|ck)(?:in|i|x|p|n)?(?:\d+(?:m|mhz|k|khz)?)?[a-z]?")
_NOT_CLOCK = _words(
    "en ena enable ce cen sel select div divider valid cnt count locked lock req ack ok stop stopped gate "
    "gated good bad loss lost edge rise fall rate period freq frequency dis disable active status mux phase "
    "src"
)
_ENABLES = frozenset(("en", "ena", "enable", "ce", "cen"))
_RESET = re.compile(
    r"(?!preset$)(?P<n1>n)?(?:a|s|p|h|g|sys|cpu|peripheral|interconnect)?"
    r"(?:rst|reset|areset|sreset|arst|srst)(?P<n2>n|b|_n)?\d*"
)
_NOT_RESET = _words(
    "done cnt count busy req request ack ok en enable val value active status vector addr count time code data"
)
_LOW_WORDS = frozenset(("n", "b", "ni", "bar", "l"))
_IO_WORDS = frozenset(("i", "o", "in", "out"))
_INTERRUPT = re.compile(r"(?:irq|interrupt|interrupts|intr|intrpt|introut|irpt|irqs)\d*")
_INT = re.compile(r"int\d*")
_NOT_INTERRUPT = _words("en enable mask clr clear ack pending status id num sel vector")


def words(name: str) -> list[str]:
    """Split a name into words, in lower case: "S_AXI_ACLK" and "sAxiAclk" have three."""
    return [word for word in _CAMEL.sub("_", name).lower().split("_") if word]


def is_clock(port: Port) -> bool:
    """Whether a port is a one-bit input named like a clock; enables, selects and counters of clocks are not."""
    return port.direction is PortDirection.IN and port.width == 1 and _says(port.name, _CLOCK, _NOT_CLOCK)


def drives_clock(port: Port) -> bool:
    """Whether a port is a one-bit output named like a clock."""
    return port.direction is PortDirection.OUT and is_clock(replace(port, direction=PortDirection.IN))


def is_reset(port: Port) -> bool:
    """Whether a port is a one-bit input named like a reset."""
    return port.direction is PortDirection.IN and port.width == 1 and _says(port.name, _RESET, _NOT_RESET)


def _says(name: str, pattern: re.Pattern[str], other: frozenset[str]) -> bool:
    """Whether a word of the name fits, and no later word (`clk_req`) or enable makes it something else."""
    found = words(name)
    place = next((number for number, word in enumerate(found) if pattern.fullmatch(word)), None)
    return place is not None and not other & set(found[place + 1 :]) and not _ENABLES & set(found)


def reset_polarity(name: str) -> Polarity:
    """LOW for `aresetn`, `rst_n`, `nreset`, `rst_ni`; HIGH otherwise."""
    found = words(name)
    for number, word in enumerate(found):
        match = _RESET.fullmatch(word)
        if match and (match["n1"] or match["n2"] or _LOW_WORDS & set(found[number + 1 :])):
            return Polarity.LOW
        if match and "n" in found[:number]:
            return Polarity.LOW
    return Polarity.HIGH


def interrupt_mode(port: Port) -> Mode | None:
    """Return MASTER for an output named like an interrupt, SLAVE for such an input, None for any other port."""
    found = words(port.name)
    if _NOT_INTERRUPT & set(found) or not _says_interrupt(found):
        return None
    return {PortDirection.OUT: Mode.MASTER, PortDirection.IN: Mode.SLAVE}.get(port.direction)


def _says_interrupt(found: list[str]) -> bool:
    """`int` is short for many things: it counts only as the last word."""
    last = next((word for word in reversed(found) if word not in _IO_WORDS and not word.isdigit()), "")
    return any(_INTERRUPT.fullmatch(word) for word in found) or bool(_INT.fullmatch(last))


def stem(name: str) -> str:
    """Remove the words that mean clock or reset from a name: "s_axi_aclk" → "s_axi", "clk" → ""."""
    rest = []
    for word in words(name):
        if _CLOCK.fullmatch(word) or _RESET.fullmatch(word) or word in _LOW_WORDS or word in _IO_WORDS:
            continue
        rest.append(word)
    return "_".join(rest)
