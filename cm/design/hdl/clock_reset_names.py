# SPDX-License-Identifier: Apache-2.0
"""Recognises clocks, resets and interrupts by common names."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from functools import lru_cache

from cm.design.hdl.model import Mode, Polarity, Port, PortDirection
from cm.frozen import replace


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


_CAMEL = re.compile(r"(?<=[a-z0-9])(?=[A-Z])")
_CLOCK = re.compile(
    r"(?!sclk)(?:[a-z0-9]{0,12}(?:clk|clock)|(?:ref|sys|mem|pix|gt)?ck)(?:in|i|x|p|n|ref)?(?:\d+(?:m|mhz|k|khz)?)?[a-z]?"
)
REGION_CLOCK = "aclk"  # of several clock ports of a region, the one that gets its clock without a word
# what is left of a word that says clock or reset: pixclk → pix, clk100 → 100; a (of AMBA's aclk) says nothing
_CLOCK_CORE = re.compile(
    r"(?P<before>[a-z0-9]{0,12}?)(?:clk|clock|(?<![a-z])ck)(?:in|i|x|p|n|ref)?(?P<after>\d\w*|[a-mo-z])?"
)
_RESET_CORE = re.compile(r"n?(?P<before>[a-z0-9]{0,12}?)(?:rst|reset|arest)(?:n|ni)?(?P<after>\d\w*|[a-h])?")
_SHORT = {"w": "wr", "write": "wr", "r": "rd", "read": "rd", "pixel": "pix", "video": "vid", "source": "src"}
_NOT_CLOCK = _words(
    "en ena enable ce cen sel select div divider valid cnt count locked lock req ack ok stop stopped gate "
    "gated gating stopstate oe oeb good bad loss lost edge rise fall rate period freq frequency dis disable active "
    "status mux phase src stall err error ovr override inh inhibit bypass polarity pol invert inv mode force test index"
)
_SETTINGS = _words("cfg config conf csr")
_ENABLES = frozenset(("en", "ena", "enable", "cen"))  # `ce` before clk is a name: ce_clk
_RESET = re.compile(  # first, burst, preset are other words, as is what a transceiver resets; a, c, …: one of several
    r"(?!\w*(?:fi|bu|wo|bo)rst|p?preset$|\w*(?:cnt|buf|scan|lpm)reset)"
    r"(?P<n1>n)?[a-z0-9]{0,12}?(?:rst|reset|arest)(?P<n2>n|b|_n)?(?:in|out|[ac-h]|\d+(?:m|mhz|k|khz)?)?"
)
_NOT_RESET = _words(
    "done cnt count busy req rq request ack ok en enable val value active status vector addr count time code data wstb "
    "stb ival oval mon monitor detect detected det"
)
_HOLDS = _ENABLES | _words("ss ssn nss cs csn csb ncs sel select ce load ld")
_LOW_WORDS = frozenset(("n", "b", "ni", "na", "bar", "l"))
_IO_WORDS = frozenset(("i", "o", "in", "out"))
_INTERRUPT = re.compile(r"[a-z0-9]*?(?:irq|interrupt|intr|intrpt|itrpt|introut|irpt|nmi)(?:s|n)?\d*")
_INT = re.compile(r"int\d*")
_INT_OF_SEVERAL = re.compile(r"int[a-d]")
_MAY_INTERRUPT = re.compile(r"int|irq|rpt|ip|nmi", re.IGNORECASE)  # few names have one of these
_NUMBERED = re.compile(r"(?:ch|lane|core|hart|port|array|lines?|req|request)\d*")
# what sets, clears or handles an interrupt, wherever the word stands
_HANDLES = _words(
    "en ena enable enabled mask masked clr clear ack trace sel select addr test force set inhibit take taken disable "
    "dis dsbl rdy allow block ignore handle halt stall flush kill suppress cfg config reg trigger triggers clk"
)
# what comes of one, behind the word: its number, its state
_OF_INTERRUPT = _words(
    "pending status state id num vector vec count cnt level valid ip code type cause prio priority edge polarity mode "
    "data ready event events sent fail active"
)
_LINES = _words("mtip msip meip seip stip ssip xeip ipi")  # RISC-V's, which are also bits of registers
_CAUSES = _words(  # before `int`, which is short for many things, in an input's name
    "ext timer tmr cpu core sys hw sw soft dma gpio uart spi i2c eth usb pci pcie phy mac host global periph peripheral"
)
# words of a reset's name that say whose it is; any other, beside a plain reset, makes it a control
_WHOSE = _words(
    "sys core cpu peripheral interconnect axi axis ap por ext aux global glbl hard hw async sync main cold warm power"
)


@lru_cache(maxsize=1024)
def words(name: str) -> tuple[str, ...]:
    """Split a name into words, in lower case: "S_AXI_ACLK" and "sAxiAclk" have three."""
    return tuple(word for word in _CAMEL.sub("_", name).lower().split("_") if word)


def is_clock(port: Port) -> bool:
    """Whether a port is a one-bit input named like a clock; enables, selects, counters and resets of clocks are not."""
    return is_wire(port) and says_clock(port.name)


@lru_cache(maxsize=1024)
def says_clock(name: str) -> bool:
    """Whether a name is that of a clock."""
    found = words(name)
    if any(_RESET.fullmatch(word) for word in found[1:]) or _SETTINGS & {*found}:
        return False
    return _says(name, _CLOCK, _NOT_CLOCK)


def is_wire(port: Port) -> bool:
    """Whether a port is an input of one bit."""
    return port.direction is PortDirection.IN and port.width == 1


def several(port: Port) -> str:
    """ "clocks" or "resets" for a vector of inputs whose name ends like one of these."""
    if port.direction is not PortDirection.IN or not port.width or port.width == 1:
        return ""
    last = [word for word in words(port.name) if word not in _IO_WORDS | _LOW_WORDS | {"p"}][-1:]
    if says_clock(port.name) and any(map(_CLOCK.fullmatch, last)):
        return "clocks"
    return "resets" if _says(port.name, _RESET, _NOT_RESET) and any(map(_RESET.fullmatch, last)) else ""


def drives_clock(port: Port) -> bool:
    """Whether a port is a one-bit output named like a clock."""
    return port.direction is PortDirection.OUT and is_clock(replace(port, direction=PortDirection.IN))


def is_reset(port: Port) -> bool:
    """Whether a port is a one-bit input named like a reset."""
    return is_wire(port) and _says(port.name, _RESET, _NOT_RESET) and words(port.name)[0] != "do"


def of_clock(port: Port, clocks: Collection[str]) -> bool:
    """Whether there is a clock of the same name but for the word: `RstData` beside `ClkData`."""
    low = port.name.lower()
    others = {low.replace(one, other) for one in ("rst", "reset") for other in ("clk", "clock") if one in low}
    return is_wire(port) and not others.isdisjoint(map(str.lower, clocks))


def _says(name: str, pattern: re.Pattern[str], other: frozenset[str]) -> bool:
    """Whether a word of the name fits, and no later word (`clk_req`) or enable makes it something else."""
    found = words(name)
    place = next((number for number, word in enumerate(found) if pattern.fullmatch(word)), None)
    return place is not None and not other & set(found[place + 1 :]) and not _ENABLES & set(found)


def says_else(name: str) -> bool:
    """Whether a name is that of an enable, a select or a load, which may hold registers in reset too."""
    return any(word in _HOLDS or word.endswith("en") for word in words(name))


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


def is_control(name: str, resets: Sequence[str], clocks: Sequence[str]) -> bool:
    """Whether a name that says reset, active high, is of something inside: `ff_reset` beside `rst_n` and one clock."""
    if len(clocks) != 1:
        return False
    domains = reset_domains(tuple(resets), tuple(clocks))
    own, others = domains[name], any(not domain for other, domain in domains.items() if other != name)
    return others and bool(own) and not ({*own} & (_WHOSE | {*clock_domains(tuple(clocks))[clocks[0]]}))


def says_what(name: str, clocks: Sequence[str]) -> bool:
    """Whether a name says what is reset (`reset_frame`, `rst_stats`), and not whose reset it is (`reset_sys_n`)."""
    found = words(name)
    place = next((number for number, word in enumerate(found) if _RESET.fullmatch(word)), None)
    whose = (
        _WHOSE | _LOW_WORDS | _IO_WORDS | {word for domain in clock_domains(tuple(clocks)).values() for word in domain}
    )
    return place is not None and any(len(word) > 2 and word.isalpha() for word in {*found[place + 1 :]} - whose)


def interrupt_mode(port: Port) -> tuple[Mode, bool] | None:
    """MASTER for an output named like an interrupt, SLAVE for such an input, and whether the name leaves no doubt."""
    if not _MAY_INTERRUPT.search(port.name):
        return None
    mode = {PortDirection.OUT: Mode.MASTER, PortDirection.IN: Mode.SLAVE}.get(port.direction)
    sure = None if mode is None else _says_interrupt(words(port.name), mode is Mode.MASTER, port.width == 1)
    return None if mode is None or sure is None or says_clock(port.name) else (mode, sure)


def says_interrupt(pin: str) -> bool:
    """Whether a name is surely that of an interrupt that a module drives."""
    return _MAY_INTERRUPT.search(pin) is not None and _says_interrupt(words(pin), True, True) is True


def _says_interrupt(found: Sequence[str], output: bool, line: bool) -> bool | None:
    """Whether a name is surely an interrupt's; None if nothing in it says so.

    It is if the word is the last (`rx_valid_irq`), or the first and a cause follows (`intr_rx_done`); words between
    others leave a doubt (`irq_ctrl_load`, `dsc_irq_arm`).
    """
    inner = [word for word in found if word not in _IO_WORDS and not word.isdigit()]
    places = [number for number, word in enumerate(inner) if _INTERRUPT.fullmatch(word)]
    if places:
        behind = [word for word in inner[places[-1] + 1 :] if len(word) > 1 and not _NUMBERED.fullmatch(word)]
        if _HANDLES & {*inner} or _OF_INTERRUPT & {*behind[:1]}:
            return None
        return not behind or places[0] == 0
    inner = inner[:-1] if inner[-1:] in (["n"], ["ni"]) else inner
    last = inner[-1] if inner else ""
    if line and output and _INT_OF_SEVERAL.fullmatch(last):  # or a processor's INTA, which acknowledges
        return None if _HANDLES & {*inner} else False
    if line and _INT.fullmatch(last):
        return None if _HANDLES & {*inner} else output or len(inner) == 1 or bool(_CAUSES & {*inner[:-1]})
    return False if line and _LINES & {*inner[-1:]} else None


@lru_cache(maxsize=64)
def clock_domains(clocks: tuple[str, ...]) -> Mapping[str, tuple[str, ...]]:
    """The words of each clock's name but those that say clock: "s_axi_aclk" → s axi, "clk" → nothing, "clk2" → 2.

    Where two have the same words, those of direction (``clk_i``) count too.
    """
    return _without_io({name: _domain(name) for name in clocks})


@lru_cache(maxsize=64)
def reset_domains(resets: tuple[str, ...], clocks: tuple[str, ...]) -> Mapping[str, tuple[str, ...]]:
    """The words of each reset's name but those that say reset and active low: "core_rst_n" → core.

    A last letter n, b or l belongs to the name (``rst_b``) if a clock, or another reset but for its a, has it too.
    """
    series = _series(resets, clocks)
    return _without_io({name: _without_low(_domain(name), series) for name in resets})


def named_low(name: str, resets: Sequence[str], clocks: Sequence[str]) -> bool:
    """Whether a reset's name says that it is active low, beside the module's other resets and clocks."""
    if name[-1:] in "bB" and f"{name[:-1]}a".lower() in map(str.lower, resets):
        return False
    domain = _inner(_domain(name))
    series = bool(domain) and domain[-1] in _LOW_WORDS and domain in _series(tuple(resets), tuple(clocks))
    return not series and reset_polarity(name) is Polarity.LOW


def _without_low(domain: tuple[str, ...], series: frozenset[tuple[str, ...]]) -> tuple[str, ...]:
    end = len(domain)
    while end and domain[end - 1] in _IO_WORDS:
        end -= 1
    core, tail = domain[:end], domain[end:]
    if core and core[-1] in _LOW_WORDS and _inner(domain) not in series:
        core = core[:-1]
    return (core[1:] if core[:1] == ("n",) else core) + tail


@lru_cache(maxsize=64)
def _series(resets: tuple[str, ...], clocks: tuple[str, ...]) -> frozenset[tuple[str, ...]]:
    """The domains whose last word, which may say active low, is a name: that of a clock, or one of a and b."""
    found = {_inner(_domain(name)) for name in resets}
    pairs = {(*domain[:-1], "b") for domain in found if domain[-1:] == ("a",)}
    return frozenset({_inner(_domain(name)) for name in clocks} | pairs)


@lru_cache(maxsize=1024)
def _domain(name: str) -> tuple[str, ...]:
    """The words of a name, and what is left of those that say clock or reset."""
    found: list[str] = []
    for word in words(name):
        match = _CLOCK_CORE.fullmatch(word) or _RESET_CORE.fullmatch(word)
        parts = (match["before"], match["after"]) if match else (word,)
        found += [part for part in parts if part and part != "ap" and not (match and part in ("a", "s"))]
    return tuple(_SHORT.get(word, word) for word in found)


def _inner(domain: tuple[str, ...]) -> tuple[str, ...]:
    """Drop the words of direction at either end."""
    while domain and domain[-1] in _IO_WORDS:
        domain = domain[:-1]
    return domain[1:] if domain and domain[0] in _IO_WORDS else domain


def _without_io(domains: Mapping[str, tuple[str, ...]]) -> dict[str, tuple[str, ...]]:
    """Drop the words of direction, unless they are what makes the difference to another port."""
    inner = {name: _inner(domain) for name, domain in domains.items()}
    alike = Counter(inner.values())
    return {name: domain if alike[inner[name]] > 1 else inner[name] for name, domain in domains.items()}
