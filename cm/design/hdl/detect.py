# SPDX-License-Identifier: Apache-2.0
"""Finds interfaces, clocks, resets and interrupts among a module's ports; each port is in one, or left over."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence

from cm.design.hdl import vivado_attributes
from cm.design.hdl.associate import associate, named_after
from cm.design.hdl.axi_signals import Protocol, aximm, axis, axis_short, hls_fifos, other_buses, plain_stream
from cm.design.hdl.clock_reset_names import (
    drives_clock,
    interrupt_mode,
    is_clock,
    is_control,
    is_reset,
    is_wire,
    named_low,
    of_clock,
    reset_domains,
    says_else,
    says_what,
    several,
)
from cm.design.hdl.group_ports import Candidate, candidates
from cm.design.hdl.model import (
    FoundBy,
    Interface,
    Interrupt,
    Leftover,
    Mode,
    ModuleClock,
    ModuleInfo,
    Polarity,
    Port,
    PortDirection,
    PortUse,
    Problem,
    Reset,
    Stated,
    unique,
)
from cm.design.hdl.user_protocols import UserProtocol
from cm.design.hdl.validate_bus import judge, make_interface
from cm.design.hdl.vivado_attributes import Tagged, read_tags
from cm.frozen import replace

NOTHING_STATED = Stated()
_UNKNOWN, _IN = PortUse(), PortDirection.IN
NOTHING_KNOWN = "belongs to no bus, clock, reset or interrupt that could be recognised"
LIKE = "is like "  # how reasons begin that name what no port of a region is


def detect(
    module: ModuleInfo,
    protocols: Sequence[UserProtocol] = (),
    stated: Stated = NOTHING_STATED,
    uses: Callable[[], Mapping[str, PortUse]] = dict,
) -> ModuleInfo:
    """Return the module with everything that was found in it.

    `uses`: what the sources do with its ports, in lower case if VHDL; it is asked where names leave a question.
    """
    return _Detection(vivado_attributes.with_statements(module, stated), protocols, uses).result(stated)


class _Detection:
    """The state of one module's detection: which ports are still free, and why some are left over."""

    def __init__(
        self, module: ModuleInfo, user: Sequence[UserProtocol], uses: Callable[[], Mapping[str, PortUse]]
    ) -> None:
        self._module = module
        self._builtin = (aximm(), axis(), axis_short(), *hls_fifos())
        self._user = user
        self._free = {port.name: port for port in module.ports if port.flat}
        self._reasons = {port.name: "is not a vector of bits" for port in module.ports if not port.flat}
        self._interfaces: list[Interface] = []
        self._problems: list[Problem] = []
        self._rejected: list[tuple[Candidate, str]] = []
        self._asked: tuple[str, ...] = ()
        self._source, self._uses = uses, dict[str, PortUse]()

    def result(self, stated: Stated) -> ModuleInfo:
        """Everything that is found; what has valid, data and acknowledge is a stream if its name is in `streams`."""
        module = self._module
        self._bind()
        tagged = read_tags(module.ports, {p.name: p for p in reversed(self._builtin)})
        self._take_tagged(tagged)
        self._drop_ignored()
        for protocol in self._builtin:
            self._by_name(protocol, FoundBy.NAME)
        for user in self._user:
            self._by_name(user.protocol, FoundBy.PROTOCOL_FILE)
        self._by_statement(plain_stream(), stated.streams)
        self._name_others()
        if not self._plain(tagged):
            self._uses = {port.lower(): use for port, use in self._source().items()}
        clocks = [*tagged.clocks, *self._clocks()]
        resets = (*tagged.resets, *self._resets(clocks))
        interrupts = (*tagged.interrupts, *(self._interrupts() if stated.interrupts is None else ()))
        driven = [port for port in self._free.values() if drives_clock(port)]
        candidates = named_after([port.name for port in driven], self._interfaces, [clock.port for clock in clocks])
        self._take(candidates)
        clocks += [vivado_attributes.clock_of(name, module.port(name), {}) for name in candidates]
        used = {port.name: self._use(port.name) for port in module.ports}
        loose = {name for name, use in used.items() if use.asynchronous or use.reset is None}
        runs = {name: use.clocks for name, use in used.items()}
        given = _stated(clocks, module.ports)
        done = associate(self._interfaces, given, resets, module.file, runs, sure=not driven, loose=loose)
        idle = {clock.port for clock in done.clocks if clock.port in candidates and not clock.interfaces}
        self._free |= {name: module.port(name) for name in idle}
        return replace(
            module,
            interfaces=done.interfaces,
            clocks=tuple(clock for clock in done.clocks if clock.port not in idle),
            resets=done.resets,
            interrupts=interrupts,
            leftovers=tuple(self._leftovers()),
            asked=self._asked,
            problems=(*module.problems, *self._problems, *self._rejections(), *done.problems),
        )

    def _rejections(self) -> Iterable[Problem]:
        """Report ports that looked like a bus but are not one, unless another protocol has taken them since."""
        for candidate, reason in self._rejected:
            first = next(iter(candidate.ports.values()))
            if first.name in self._reasons:
                yield Problem(reason, first.file, first.line)

    def _take(self, names: Iterable[str]) -> None:
        for name in names:
            self._free.pop(name, None)

    def _bind(self) -> None:
        """Add the interfaces that the protocols file declares port by port."""
        for user in self._user:
            for binding in user.bindings:
                if binding.module.lower() != self._module.name.lower():
                    continue
                missing = [name for name in binding.ports.values() if name not in self._free]
                if missing:
                    message = (
                        f"{binding.where}: {binding.name}: module {binding.module} has no port {', '.join(missing)}"
                    )
                    self._problems.append(Problem(message, self._module.file, self._module.line, fatal=True))
                    continue
                ports = {signal: self._free[name] for signal, name in binding.ports.items()}
                found = make_interface(binding.name, user.protocol, binding.mode, ports, FoundBy.PROTOCOL_FILE)
                self._add(replace(found, clock=binding.clock or None, reset=binding.reset or None))

    def _add(self, interface: Interface) -> None:
        self._interfaces.append(interface)
        self._take(interface.ports.values())
        for name in interface.ports.values():
            self._reasons.pop(name, None)

    def _take_tagged(self, tagged: Tagged) -> None:
        for port in tagged.malformed.values():
            text = f'port {port.name}: X_INTERFACE_INFO is not "vendor:library:name:version BUS SIGNAL"'
            self._problems.append(Problem(text, port.file, port.line))
        self._reasons.update(tagged.rejected)
        self._take(clock.port for clock in tagged.clocks)
        self._take(reset.port for reset in tagged.resets)
        self._take(interrupt.port for interrupt in tagged.interrupts)
        for interface in tagged.interfaces:
            self._add(self._completed(interface))
        self._problems.extend(Problem(text, self._module.file, self._module.line) for text in tagged.problems)
        self._take(tagged.rejected)

    def _completed(self, interface: Interface) -> Interface:
        """Complete a bus of which only some ports have attributes by the names of the others."""
        protocol = next((p for p in self._builtin if p.vlnv == interface.vlnv), None)
        if protocol is None:
            return interface
        tagged = {name: port for name in interface.ports.values() if (port := self._free.get(name))}
        for found in candidates([*tagged.values(), *self._unmarked()], protocol):
            ours = {signal: port for signal, port in found.ports.items() if port.name in tagged}
            new = {signal: port for signal, port in found.ports.items() if signal not in interface.ports}
            if ours and new and judge(interface.name, protocol, found.ports).mode is interface.mode:
                both = {signal: self._free[name] for signal, name in interface.ports.items()} | new
                return make_interface(
                    interface.name, protocol, interface.mode, both, FoundBy.ATTRIBUTE, interface.parameters
                )
        return interface

    def _unmarked(self) -> list[Port]:
        return [p for p in self._free.values() if "x_interface_info" not in p.attributes]

    def _drop_ignored(self) -> None:
        for port in list(self._free.values()):
            if vivado_attributes.ignored(port):
                self._reasons[port.name] = "is marked X_INTERFACE_IGNORE"
                self._take((port.name,))

    def _by_name(self, protocol: Protocol, found_by: FoundBy) -> None:
        for candidate in map(self._with_plain, list(candidates(self._free.values(), protocol))):
            verdict = judge(candidate.name or protocol.name, protocol, candidate.ports)
            if verdict.mode is None:
                self._reject(candidate, verdict.reason)
                continue
            name = candidate.name or f"{verdict.mode.value[0]}_{protocol.name}".replace("mm", "")
            name = unique(name, (interface.name for interface in self._interfaces))
            stated: dict[str, str] = {}
            for port in candidate.ports.values():
                stated.update(vivado_attributes.parameters(port))
            self._add(make_interface(name, protocol, verdict.mode, candidate.ports, found_by, stated))

    def _by_statement(self, stream: Protocol, streams: Sequence[str] | None) -> None:
        """Add the streams that the build schema names, and ask about others if it says nothing."""
        wanted = {name.lower() for name in streams or ()}
        asked: dict[str, Candidate] = {}
        for found in [*map(self._with_data, candidates(self._unrejected(), stream))]:
            mode = judge(found.name, stream, found.ports).mode
            if mode is None or not found.name:
                continue
            waits = "TREADY" in found.ports
            if not waits and found.name.lower() not in wanted:
                say = f"{LIKE}a stream without ready: streams: [{found.name}] in the module, if it is one"
                self._reasons |= {port.name: say for port in found.ports.values() if streams is None}
                continue
            self._go_with(found)
            if found.name.lower() in wanted:
                self._add(make_interface(found.name, stream, mode, found.ports, FoundBy.PROTOCOL_FILE))
                wanted.discard(found.name.lower())
            else:
                asked[found.name] = found
        for name in wanted:
            text = f"streams: names {name}, of which {self._module.name} has no valid, data and ack that fit"
            self._problems.append(Problem(text, self._module.file, self._module.line, fatal=True))
        self._asked = tuple(asked) if streams is None else ()
        for found in asked.values() if streams is None else ():
            self._reject(
                found,
                f"looks like a stream that {found.ports['TREADY'].name} acknowledges: if a beat is over when that and "
                f"{found.ports['TVALID'].name} are high, write streams: [{', '.join(asked)}] in the module, else []",
            )
        if streams is None:
            self._ask_about_fifos(stream)

    def _with_data(self, found: Candidate) -> Candidate:
        """With the data that a stream is called after: `tag`, `tag_valid`, `tag_ready`."""
        own = {found.name.lower(), *(f"{found.name.lower()}_{way}" for way in ("i", "o", "in", "out"))}
        data = next((port for port in self._unrejected() if port.name.lower() in own and not is_wire(port)), None)
        return found if data is None or "TDATA" in found.ports else replace(found, ports={**found.ports, "TDATA": data})

    def _with_plain(self, found: Candidate) -> Candidate:
        """With the signals of a stream that lack its t: `out_tvalid`, `out_tready`, `out_data`."""
        valid = found.ports.get("TVALID")
        if valid is None or "TDATA" in found.ports or found.protocol.name != "axis":
            return found
        named = {valid.name.lower().replace("tvalid", signal[1:].lower()): signal for signal in found.protocol.signals}
        more = {
            named[port.name.lower()]: port
            for port in self._free.values()
            if port.name.lower() in named and port.direction is valid.direction and port.name != valid.name
        }
        return replace(found, ports={**more, **found.ports}) if "TDATA" in more else found

    def _name_others(self) -> None:
        """Name what is a bus of another kind, or a handshake that no bus has."""
        for protocol in other_buses():
            for found in list(candidates(self._unrejected(), protocol)):
                if judge(found.name, protocol, found.ports).mode is not None:
                    say = f"{LIKE}{protocol.name}, which a region's ports are not: a protocols file can describe it"
                    self._reasons |= {port.name: say for port in found.ports.values()}

    def _ask_about_fifos(self, stream: Protocol) -> None:
        """The sides of a FIFO (VLSI-EDA/PoC) are streams by a line of HDL, as `full` is TREADY turned round."""
        free = {port.name.lower(): port for port in self._free.values()}
        for (valid, data, ready), said in ((("put", "din", "full"), "not full"), (("valid", "dout", "got"), "got")):
            if {valid, data, ready} <= free.keys():
                self._reject(
                    Candidate(valid, stream, {"TVALID": free[valid], "TDATA": free[data], "TREADY": free[ready]}),
                    f"looks like a side of a FIFO, which is a stream with TVALID {valid}, TDATA {data} and "
                    f"TREADY {said}: a module around it gives it these ports, or streams: [] says that it is none",
                )

    def _go_with(self, stream: Candidate) -> None:
        """Ports such as `Out_Meta_rst` reset no register: they begin with the stream's name, and go with it.

        `Out_RstIn` is the reset of that side.
        """
        for port in self._free.values():
            if not port.name.lower().startswith(f"{stream.name.lower()}_") or not is_reset(port):
                continue
            if "meta" in reset_domains((port.name[len(stream.name) :],), ())[port.name[len(stream.name) :]]:
                self._reasons[port.name] = f"goes with the stream {stream.name}"

    def _reject(self, candidate: Candidate, reason: str) -> None:
        if _worth_a_word(candidate):
            self._reasons.update({port.name: reason for port in candidate.ports.values()})
            self._rejected.append((candidate, reason))

    def _use(self, port: str) -> PortUse:
        return self._uses.get(port.lower(), _UNKNOWN)

    def _plain(self, tagged: Tagged) -> bool:
        """Whether names leave no question: one clock, perhaps a reset that is named active low, no other wire."""
        wires = [port for port in self._free.values() if is_wire(port)]
        clocks = [port.name for port in wires if is_clock(port)]
        resets = [port.name for port in wires if is_reset(port)]
        low = all(named_low(name, resets, clocks) for name in resets)
        return (
            len(wires) == len(clocks) + len(resets)
            and len(clocks) + len(tagged.clocks) == 1
            and len(resets) < 2
            and low
        )

    def _clocks(self) -> list[ModuleClock]:
        """Those that the sources show to be clocks, and those that are named so, unless a clock only samples them."""
        free = [(port, self._use(port.name)) for port in self._unrejected()]
        found = [port for port, use in free if (use.clock and is_wire(port)) or (is_clock(port) and not use.clocks)]
        found = [port for port in found if not is_reset(port)]
        self._take(port.name for port in found)
        return [vivado_attributes.clock_of(port.name, port, vivado_attributes.parameters(port)) for port in found]

    def _resets(self, clocks: Sequence[ModuleClock]) -> list[Reset]:
        """Likewise; of those that are only named so, `ff_reset` beside a reset is none, and `rst` beside `set`."""
        every = {port.name.lower() for port in self._module.ports}
        every_clock = [clock.port for clock in clocks]
        named = [
            port
            for port in self._unrejected()
            if (is_reset(port) or of_clock(port, every_clock)) and not _beside(port.name, "reset rst", "set", every)
        ]
        for port in self._unrejected():
            if is_wire(port) and self._use(port.name).asynchronous and port not in named and says_else(port.name):
                line = f"resets: {{{port.name}: {{polarity: {(self._use(port.name).reset or Polarity.LOW).value}}}}}"
                self._reasons[port.name] = (
                    f"resets registers at once, by a name of something else: {line}, if it is one"
                )
        proven = [port for port in self._unrejected() if self._is_reset(port) and is_wire(port) and port not in named]
        ports = [*named, *proven]
        names, inputs = [port.name for port in ports], [clock.port for clock in clocks if clock.direction is _IN]
        levels = {port.name: self._polarity(port, names, inputs) for port in ports}
        found = [
            port
            for port in ports
            if self._use(port.name).reset
            or levels[port.name] is Polarity.LOW
            or not (is_control(port.name, names, inputs) or self._sampled(port.name, inputs))
        ]
        for port in (port for port in named if port not in found):
            line = f"resets: {{{port.name}: {{polarity: {Polarity(levels[port.name] or Polarity.HIGH).value}}}}}"
            self._reasons[port.name] = f"{LIKE}a reset of something inside: {line}, if it resets the module"
        for port in self._unrejected():
            if what := several(port):
                self._reasons[port.name] = (
                    f"{LIKE}{port.width} {what} side by side: needs a flat wrapper that splits them"
                )
        self._take(port.name for port in found)
        return [Reset(port.name, port.name, levels[port.name]) for port in found]

    def _sampled(self, name: str, clocks: Sequence[str]) -> bool:
        """Whether registers take it at a clock's edges, none is reset by it, and its name says what it is for."""
        return bool(self._use(name).clocks) and says_what(name, clocks)

    def _is_reset(self, port: Port) -> bool:
        use = self._use(port.name)
        return use.asynchronous and not says_else(port.name)

    def _polarity(self, port: Port, resets: Sequence[str], clocks: Sequence[str]) -> Polarity | None:
        named = Polarity.LOW if named_low(port.name, resets, clocks) else Polarity.HIGH
        stated = vivado_attributes.polarity_of(vivado_attributes.parameters(port))
        use = self._use(port.name)
        generic = {p.name.lower(): str(p.value).strip("'") for p in self._module.parameters if use.constant}
        level = {"1": Polarity.HIGH, "0": Polarity.LOW}.get(generic.get(use.constant.lower(), ""))
        unknown = use.constant and use.constant.lower() not in generic and named is Polarity.HIGH  # no n is in the name
        return stated or use.reset or level or (None if unknown else named)

    def _interrupts(self) -> list[Interrupt]:
        names = {port.name.lower() for port in self._module.ports}
        named = [
            (port, *said)
            for port in self._unrejected()
            if (said := interrupt_mode(port)) and not _beside(port.name, "int", "ext", names)
        ]
        told = {port.name for port, _, _ in named}
        named += [
            (port, Mode.MASTER, False) for port in self._unrejected() if port.name not in told and self._is_irq(port)
        ]
        for port in (port for port, _, sure in named if not sure):
            line = f"interrupts: [{port.name}] in the module, with all that are, if it is one"
            self._reasons[port.name] = f"{LIKE}an interrupt: {line}"
        found = [(port, mode) for port, mode, sure in named if sure]
        self._take(port.name for port, _ in found)
        return [
            Interrupt(port.name, port.name, mode, port.width, vivado_attributes.parameters(port).get("SENSITIVITY", ""))
            for port, mode in found
        ]

    def _is_irq(self, port: Port) -> bool:
        """Whether an output of one bit is at the interrupt of an instance."""
        return self._use(port.name).interrupt and port.direction is PortDirection.OUT and port.width == 1

    def _unrejected(self) -> list[Port]:
        return [port for port in self._free.values() if port.name not in self._reasons]

    def _leftovers(self) -> Iterable[Leftover]:
        for port in self._module.ports:
            if port.name in self._reasons or port.name in self._free:
                yield Leftover(port.name, self._reasons.get(port.name, NOTHING_KNOWN))


def _worth_a_word(candidate: Candidate) -> bool:
    """Whether to report ports: a single one, or wdata and rdata without a handshake, may be named so by chance."""
    worth = candidate.protocol.worth
    enough = any(marks <= set(candidate.ports) for marks in worth) if worth else True
    return (enough or _channel_alone(candidate)) and len(candidate.ports) > 1


def _channel_alone(candidate: Candidate) -> bool:
    """Whether one channel of AXI has its handshake, `m_axi_wvalid` and `m_axi_wready`; `w_valid` may be any word."""
    ports = [[candidate.ports.get(channel + end) for end in ("VALID", "READY")] for channel in "WBR"]
    return any(
        valid and ready and f"{channel}valid" in valid.name.lower() and f"{channel}ready" in ready.name.lower()
        for channel, (valid, ready) in zip("wbr", ports, strict=True)
    )


def _beside(name: str, words: str, other: str, names: Collection[str]) -> bool:
    """Whether there is the same name with another word: beside `blowoff_ext`, `blowoff_int` is what is internal."""
    name = name.lower()
    return any(word in name and name.replace(word, other) in names for word in words.split())


def _stated(clocks: Iterable[ModuleClock], ports: Sequence[Port]) -> list[ModuleClock]:
    """Clocks with their associated resets checked: an attribute may name a port that does not exist."""
    names = {port.name.lower(): port.name for port in ports}
    found = ((clock, tuple(names[name.lower()] for name in clock.resets if name.lower() in names)) for clock in clocks)
    return [replace(clock, resets=resets, reset=next(iter(resets), None)) for clock, resets in found]
