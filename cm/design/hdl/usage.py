# SPDX-License-Identifier: Apache-2.0
"""What the sources do with a module's ports: which are clocks and resets, and on which clock each is used.

Sources are searched for edges (``@(posedge x)``, ``rising_edge(x)``), for what is tested behind them, for plain
copies of signals, and for what instances are given, at any depth. Of an instance whose module no file declares, the
names of its pins tell: what goes to `s_axis_tdata` is used at the edges of what goes to `s_clk`. What is not found is
not known, and no proof.
"""

from __future__ import annotations

import itertools
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping

from cm.design.hdl.associate import best_fit
from cm.design.hdl.clock_reset_names import clock_domains, says_clock, says_interrupt
from cm.design.hdl.model import Polarity, PortUse
from cm.frozen import dataclass, field

Pins = tuple[str, Mapping[str, tuple[str, bool]]]  # an instance's module, and by port: the signal, whether inverted
_MOST = 64  # copies of copies that are followed

# what is asserted happens at the edges of signals that clock nothing
_ASSERTED = re.compile(
    r"\b(?:assert|assume|cover|restrict)\s+property\b[^;]*;|\b(property|sequence)\b.*?\bend\1\b", re.DOTALL
)
_BLOCK = re.compile(r"@\s*\((?P<edges>[^()]*\b(?:pos|neg)edge\b[^()]*)\)")
_NEXT = re.compile(r"\b(?:always\w*|assign|initial|endmodule|generate|endgenerate)\b|\(\s*\.\s*\w+\s*\(|#\s*\(\s*\.")
_OPENS = re.compile(r"\s*begin\b")
_BEGIN_END = re.compile(r"\b(?:begin|end)\b")
_EDGE = re.compile(r"\b(pos|neg)edge\s+(\w+)")
_TEST = re.compile(
    r"\bif\s*\(\s*([!~])?\s*\(?\s*(\w+)\s*\)?\s*(?:==+\s*(?:\d+'[bhd]|')?([01])\s*)?\)(.*?)(?:\belse\b|\bend\b|\Z)",
    re.DOTALL,
)
_ASSIGNS = re.compile(r"[^=!<>]=[^=]|<=")
# a signal that is another one, turned round by a parameter: assign rst = arst_i ^ LEVEL
_XOR = re.compile(r"(?:assign|wire|logic)\s+(\w+)\s*=\s*(\w+)\s*\^\s*(\w+)\s*;")
_COPY = re.compile(r"(?:assign|wire|logic)\s+(\w+)\s*=\s*([!~])?\s*(\w+)\s*;")
# a member of an interface that is given a port, or that a port is given, as in a flat wrapper
_MEMBER = re.compile(r"assign\s+(\w+)(?:\.\w+)?\s*=\s*(\w+)(?:\.\w+)?\s*;")
_CHOICE = re.compile(r"assign\s+(\w+)\s*=[^;?:]*\?\s*(\w+)\s*:\s*(\w+)\s*;")
_FIELD = re.compile(r"(?m)^\s*(\w+)(?:\.[\w.]+)?\s*<=\s*(\w+)(?:\.[\w.]+)?\s*;")
_LEVELS = {"pos": Polarity.HIGH, "neg": Polarity.LOW}
_WORD = re.compile(r"\w+")
_VALUE = re.compile(r"<=\s*(?:#\s*\w+\s*)?([^;]+);")
_VARIABLE = re.compile(r"(?<!['\w.])[a-z]\w*")

# a parameter, by its name, and how often something is repeated
_CONSTANT = re.compile(r"\w*(?:init|reset|rst|default)\w*|(?<=\{)\s*\w+\s*(?=\{)", re.IGNORECASE)

_PROCESS = re.compile(r"\bprocess\b(.*?)\bend\s+process\b", re.DOTALL)
_RISING = re.compile(
    r"\b(rising|falling)_edge\s*\(\s*(\w+)\s*\)|\b(\w+)\s*'\s*event\s+and\s+\w+\s*=\s*(?:'([01])'|\w+)"
)
_TESTED = re.compile(
    r"\bif\s*\(?\s*(\w+)\s*=\s*(?:'([01])'|(\w+))\s*\)?\s*then(.*?)(?:\belsif\b|\belse\b|\bend\b|\Z)", re.DOTALL
)
_XOR_VHDL = re.compile(r"(?m)^\s*(\w+)\s*<=\s*(\w+)\s+xor\s+(\w+)\s*;")
_SAME = re.compile(r"(?m)^\s*(\w+)\s*<=\s*(not\s+)?(?:std_u?logic\s*\(\s*)?(\w+)\s*\)?\s*;")
_MAPPED = re.compile(
    r":\s*(?:entity\s+\w+\.|component\s+)?(\w+)\s+(?:generic\s+map\b[^;]*?)?port\s+map\s*\(([^;]*)\)\s*;"
)
_PIN = re.compile(
    r"(\w+)\s*=>\s*(not\s+)?(?:(?:std_u?logic(?:_vector)?|(?:u_)?(?:un)?signed)\s*\(\s*)?(\w+)\s*\)?\s*(?=,|$|\))"
)
_SAYS_RESET = re.compile(r"rst|reset|clear|init", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Body:
    """What one module does itself, by signal: in `steps`, a clock and the words of what happens at its edges."""

    steps: tuple[tuple[str, frozenset[str]], ...] = ()
    # signal, level or the name of a constant that has it, clock, and whether it is asynchronous
    resets: tuple[tuple[str, Polarity | str, str, bool], ...] = ()
    copies: tuple[tuple[str, bool, str], ...] = ()  # a signal that is another one, perhaps inverted
    instances: tuple[Pins, ...] = ()
    turned: tuple[tuple[str, str, str], ...] = ()  # a signal, the one that it is, and the constant that inverts it
    choices: tuple[tuple[str, str, str], ...] = ()  # a signal that is one of two others
    members: tuple[tuple[str, str], ...] = ()  # an interface or a record and another signal, in either order


def verilog_body(text: str, instances: Iterable[Pins]) -> Body:
    """The body of a module, from its source without comments."""
    text = _ASSERTED.sub(" ", text) if "property" in text or "endsequence" in text else text
    steps: dict[str, set[str]] = {}
    resets = []
    for match in _BLOCK.finditer(text):
        block = text[match.end() : _end(text, match.end())]
        if not _ASSIGNS.search(block):  # it only says something
            continue
        edges = _EDGE.findall(match["edges"])
        first = _TEST.search(block)
        clocks = [name for _, name in edges if len(edges) == 1 or first is None or name != first[2]]
        if len(clocks) != 1:
            continue
        (clock,) = clocks
        steps.setdefault(clock, set()).update(_WORD.findall(block))
        resets += [(name, _LEVELS[edge], clock, True) for edge, name in edges if name != clock]
        for turned, name, value, inside in _TEST.findall(block) if _SAYS_RESET.search(block) else ():
            level = _level((turned == "") != (value == "0"), inside) if _SAYS_RESET.search(name) else None
            resets += [(name, level, clock, False)] if level else []
    copies = tuple((one, bool(turned), other) for one, turned, other in _COPY.findall(text))
    parts = tuple((c, frozenset(names)) for c, names in steps.items())
    others = [tuple(found.findall(text)) for found in (_XOR, _CHOICE, _MEMBER)]
    return Body(parts, tuple(resets), copies, tuple(instances), *others)


def _end(text: str, start: int) -> int:
    """Where the statement behind an event control ends: with its `end`, or before the next thing that is none of it."""
    depth = 0
    for word in _BEGIN_END.finditer(text, start) if _OPENS.match(text, start) else ():
        depth += 1 if word[0] == "begin" else -1
        if depth == 0:
            return word.end()
    end = _NEXT.search(text, start)
    return end.start() if end else len(text)


def _level(high: bool, inside: str) -> Polarity | None:
    values = _VALUE.findall(inside)
    if not values or any(_VARIABLE.search(_CONSTANT.sub("0", value)) for value in values):
        return None
    return Polarity.HIGH if high else Polarity.LOW


def vhdl_body(text: str) -> Body:
    """The body of an entity, from its architectures in lower case."""
    steps, resets = [], []
    for (process,) in (match.groups() for match in _PROCESS.finditer(text)):
        edges = list(_RISING.finditer(process))
        clocks = {match[2] or match[3] for match in edges}
        if len(clocks) != 1:
            continue
        (clock,) = clocks
        steps.append((clock, frozenset(_WORD.findall(process))))
        for number, match in enumerate(_TESTED.finditer(process)):
            before = number == 0 and match.end() <= edges[0].start()  # later ones are inside what is reset
            around = match.start(4) <= edges[0].start() < match.end(4)  # what is reset stands behind `else`
            level = {"1": Polarity.HIGH, "0": Polarity.LOW}.get(match[2] or "")
            if match[4].lstrip().startswith("assert"):  # it only says something
                continue
            if before or (level and _SAYS_RESET.search(match[1])):
                resets.append((match[1], _turned(level, around) if level else match[3], clock, before or around))
    copies = tuple((one, bool(turned), other) for one, turned, other in _SAME.findall(text))
    instances = tuple(
        (unit, {port: (signal, bool(turned)) for port, turned, signal in _PIN.findall(pins)})
        for unit, pins in _MAPPED.findall(text)
    )
    turned = tuple(_XOR_VHDL.findall(text))
    return Body(tuple(steps), tuple(resets), copies, instances, turned, (), tuple(_FIELD.findall(text)))


class Usage:
    """Answers for modules, each once; `body`: what a module does itself, and its ports, None for one not given."""

    def __init__(self, body: Callable[[str], tuple[Body, tuple[str, ...]] | None]) -> None:
        self._body = body
        self._known: dict[str, dict[str, PortUse]] = {}

    def of(self, module: str, pins: Iterable[str] = ()) -> Mapping[str, PortUse]:
        """The use of its ports; those of which nothing is known are left out. `pins`: of an instance."""
        if module not in self._known:
            given = self._body(module)
            if given is None:
                return _by_names(tuple(pins))
            self._known[module] = {}  # while it is looked for: an instance of itself says nothing
            self._known[module] = _Ports(*given, self.of).result()
        return self._known[module]


def _by_names(pins: tuple[str, ...]) -> Mapping[str, PortUse]:
    """The use of the pins of a module that is not known: one clock, or the one whose name fits better than others."""
    divided = next((pin for pin in pins if pin.lower() == "clkdiv"), "")  # a SERDES has all but its pad's side there
    clocks = tuple(pin for pin in pins if says_clock(pin) or pin == divided)
    domains = {clock: "_".join(words) for clock, words in clock_domains(clocks).items()}
    fits = {pin: divided or (best_fit(pin, domains) if len(clocks) > 1 else clocks[0]) for pin in pins if clocks}
    others = {pin: clock for pin, clock in fits.items() if clock and "clk" not in pin.lower()}  # CLKDIV may be a clock
    used = {pin: PortUse(clocks=(clock,)) for pin, clock in others.items()}
    return used | {clock: PortUse(clock=True) for clock in clocks}


@dataclass(slots=True)
class _Found:
    clock: bool = False
    levels: set[Polarity] = field(default_factory=set)
    asynchronous: bool = False
    clocks: dict[str, None] = field(default_factory=dict)
    constant: str = ""
    interrupt: bool = False


class _Ports:
    """What happens to the ports of one module."""

    def __init__(
        self, body: Body, ports: tuple[str, ...], below: Callable[[str, Iterable[str]], Mapping[str, PortUse]]
    ) -> None:
        self._body, self._below = body, below
        self._origin = {port: (port, False) for port in ports}  # signal → the port that it is, and whether inverted
        turns = {a: turned for a, turned, _ in body.copies}
        given = Counter(a for a, _, _ in set(body.copies))  # what generate constructs give several is not known
        for _ in range(_MOST):
            new = {a: b for a, _, b in body.copies if given[a] == 1 and a not in self._origin and b in self._origin}
            if not new:
                break
            self._origin |= {a: (self._origin[b][0], self._origin[b][1] != turns[a]) for a, b in new.items()}
        self._members: dict[str, set[str]] = {}  # of an interface: the ports that are its members
        for one, other in body.members:
            for whole, port in ((one, other), (other, one)):
                if port in ports and whole not in ports:
                    self._members.setdefault(whole, set()).add(port)
        self._found: dict[str, _Found] = {}

    def result(self) -> dict[str, PortUse]:
        for clock, names in self._body.steps:
            self._clock(clock)
            if clock in self._origin:
                for port in sorted({self._origin[name][0] for name in names if name in self._origin}):
                    self._runs(port, clock)
        for name, level, clock, asynchronous in self._body.resets:
            self._reset(name, level, (clock,), asynchronous)
        for module, pins in self._body.instances:
            for pin, (name, _) in pins.items():
                if name in self._origin and says_interrupt(pin):
                    self._at(self._origin[name][0]).interrupt = True
            for pin, use in self._below(module, pins).items():
                if pin in pins or "*" in pins:
                    self._pin(pins, pin, use)
        return {
            port: PortUse(
                found.clock,
                found.levels.copy().pop() if len(found.levels) == 1 else None,
                found.asynchronous,
                tuple(clock for clock in found.clocks if clock != port),
                "" if found.levels else found.constant,
                found.interrupt,
            )
            for port, found in self._found.items()
        }

    def _pin(self, pins: Mapping[str, tuple[str, bool]], pin: str, use: PortUse) -> None:
        name, turned = pins.get(pin, (pin, False))
        clocks = tuple(pins.get(clock, (clock, False))[0] for clock in use.clocks if clock in pins or "*" in pins)
        if use.clock:
            self._clock(name)
        if use.reset is not None or use.constant:
            self._reset(name, _turned(use.reset, turned) if use.reset else "", clocks, use.asynchronous)
        else:
            of = {self._origin[name][0]} if name in self._origin else self._members.get(name, set())
            for port, clock in itertools.product(sorted(of), clocks):
                self._runs(port, clock)

    def _clock(self, name: str) -> None:
        """A clock, also one that is chosen from others."""
        names = {name}
        for one, first, second in (*self._body.choices, *reversed(self._body.choices)):
            names |= {first, second} if one in names else set()
        for known in names & self._origin.keys():
            self._at(self._origin[known][0]).clock = True

    def _reset(self, name: str, level: Polarity | str, clocks: Iterable[str], asynchronous: bool) -> None:
        by = next(((port, constant) for one, port, constant in self._body.turned if one == name), None)
        if by and by[0] in self._origin and isinstance(level, Polarity):
            name, level = by[0], by[1] if level is Polarity.LOW else ""
        if name not in self._origin:
            return
        port, turned = self._origin[name]
        found = self._at(port)
        if isinstance(level, Polarity):
            found.levels.add(_turned(level, turned))
        else:
            found.constant = level
        found.asynchronous |= asynchronous
        for clock in clocks:
            self._runs(port, clock)

    def _runs(self, port: str, clock: str) -> None:
        if clock in self._origin:
            self._at(port).clocks[self._origin[clock][0]] = None

    def _at(self, port: str) -> _Found:
        return self._found.setdefault(port, _Found())


def _turned(level: Polarity, turned: bool) -> Polarity:
    return level if not turned else Polarity.LOW if level is Polarity.HIGH else Polarity.HIGH
