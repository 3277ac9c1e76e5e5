# SPDX-License-Identifier: Apache-2.0
"""A system → the runtime schema that the CM loads (`cm.schema.model.Config`).

The runtime schema as text, with a comment wherever the user should decide something.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path

from cm.design.errors import BuildError
from cm.design.plan.addresses import Window
from cm.design.plan.stream_frames import frame_problem
from cm.design.plan.switch import COMMIT, CONTROL, MUX, NONE, UPDATE, chain_of, register_name, route_values
from cm.design.plan.system import Implementation, RegionPlan, RegisterBus, SwitchPlan, System
from cm.design.project.model import ModeSpec, ModuleSpec
from cm.design.project.source_position import fault
from cm.design.runtime.answers import Answers, StreamAnswer
from cm.frozen import replace
from cm.schema import dump
from cm.schema.model import (
    Access,
    Config,
    ConfigType,
    Decoupler,
    Direction,
    Identity,
    Interrupt,
    LoaderKind,
    Memory,
    Mode,
    Module,
    Overlay,
    Region,
    Register,
    StaticIdentity,
    Stream,
)
from cm.schema.pictures import pixel_shape
from cm.schema.problems import did_you_mean

REGION_BLOCK = 0x100  # of cm_control.v
REGION_STRIDE = 0x10
IDENTITY = 0xC
IRQ_STATUS, IRQ_BANK = 0x08, 0x10  # lines 32 and up: at 0x20, 0x24, and so on every 0x10
STATIC_ID = 0x1C


def runtime_config(system: System, answers: Answers) -> Config:
    """Return the configuration that `system` gives on the target."""
    project = system.project
    overlays = (Overlay(f"{project.name}_static"),) if answers.static_overlay else ()
    streams = {stream.name: stream for stream in _streams(system, answers)}
    return Config(
        name=project.name,
        type=ConfigType.PARTIAL,
        device=system.device,
        default_mode=answers.default_mode or project.default_mode,
        regions={region.name: _region(system, region) for region in system.regions},
        modules={one.name: _module(project.source, one, answers) for one in system.implementations},
        modes={mode.name: _mode(system, mode, streams) for mode in project.modes.values()},
        registers=_static_registers(system),
        overlays=overlays,
        streams=streams,
        interrupts={line.name: _interrupt(system, line.name, line.bit) for line in system.lines},
        clocks=project.clocks,
        doc=project.doc,
        static=_static(system),
    )


def _static(system: System) -> StaticIdentity | None:
    if not system.static_identity:
        return None
    return StaticIdentity(system.static_identity, system.control.base, STATIC_ID)


def register_window(source: Path, region: RegionPlan, module: ModuleSpec, name: str) -> Window:
    """The window in which a register or memory of the module is; `source`: the build schema."""
    buses = {bus.interface.name: bus for bus in region.registers}
    interface = module.interface_of.get(name, module.interface)
    if interface is not None:
        if interface not in buses:
            message = f"region {region.name} has no register interface {interface!r}"
            place = ("register_map", interface) if interface in module.register_maps else ("interface",)
            raise fault(source, ("modules", module.name, *place), message, did_you_mean(interface, buses))
        return buses[interface].window
    if len(buses) != 1:
        have = f"{len(buses)} register interfaces ({', '.join(buses)})" if buses else "no register interface"
        message = f"{module.name} has registers, and region {region.name} has {have}"
        hint = "write interface: in the module" if buses else "none of its modules has an AXI4-Lite slave"
        key = "register_map" if module.register_maps else "registers"
        raise fault(source, ("modules", module.name, key), message, hint)
    return next(iter(buses.values())).window


def _region(system: System, region: RegionPlan) -> Region:
    block = REGION_BLOCK + REGION_STRIDE * region.index
    decoupler = Decoupler(system.control.base, block) if region.spec.decoupling else None
    identity = Identity(system.control.base, block + IDENTITY)
    return Region(name=region.name, loader=region.spec.loader, decoupler=decoupler, identity=identity)


def _module(source: Path, one: Implementation, answers: Answers) -> Module:
    name, module, region = one.name, one.module, one.region.name
    registers: dict[str, Register] = {}
    memories: dict[str, Memory] = {}
    windows = {key: register_window(source, one.region, module, key) for key in (*module.registers, *module.memories)}
    ends = {("registers", key): spec.offset + spec.width // 8 for key, spec in module.registers.items()}
    ends |= {("memories", key): spec.offset + spec.size for key, spec in module.memories.items()}
    for (kind, key), end in ends.items():
        if end > windows[key].size:
            message = f"{key} ends at {end:#x}, its window has {windows[key].size:#x} bytes"
            place = ("modules", module.name, kind, key, "offset")
            raise fault(source, place, message, "window: of the region says how many")
    for key, spec in module.registers.items():
        registers[key] = _placed(spec, windows[key].base, region, answers.registers.get((name, key)))
    for key, array in module.memories.items():
        own = f"{key}_memory" if key in registers else key
        memories[own] = replace(array, name=own, base_address=windows[key].base, region=region)
    for bus in bare_windows(source, one.region, module):
        doc = f"{bus.interface.name}, of which no registers are known"
        bits = bus.interface.addr_width or 32  # beyond them it is the same again
        size = min(bus.window.size, max(1 << bits, 4))
        memory = Memory(bare_name(name, bus), bus.window.base, size, region=region, doc=doc)
        memories[memory.name] = memory
    return Module(
        name=name,
        region=region,
        bitstream=Path(f"{name}.bin"),
        identity=one.identity,
        model=module.model or (module.name if module.name != name else None),
        registers=registers,
        doc=module.doc,
        memories=memories,
    )


def bare_windows(source: Path, region: RegionPlan, module: ModuleSpec) -> list[RegisterBus]:
    """The windows that a module has, and no registers in them; `source`: the build schema."""
    used = {register_window(source, region, module, name).base for name in (*module.registers, *module.memories)}
    present = {c.boundary for c in region.boundary.adaptation(module.name).connections if c.module}
    return [
        bus
        for bus in region.registers
        if bus.window.base not in used and present.intersection(bus.interface.ports.values())
    ]


def bare_name(implementation: str, bus: RegisterBus) -> str:
    """The name of the memory that such a window is in the runtime schema."""
    return f"{implementation}_{bus.interface.name}"[:64]


def _placed(spec: Register, base: int, region: str, default: int | None = None) -> Register:
    """A register of the build schema in its window; `default` in place of its own."""
    default = spec.default if default is None else default
    return replace(spec, base_address=base, region=region, default=default)


def _mode(system: System, mode: ModeSpec, streams: Mapping[str, Stream]) -> Mode:
    chosen = [system.implementation(module, region) for region, module in mode.modules.items()]
    source, static = system.project.source, system.project.static.registers
    registers = {key: replace(static[key], default=value) for key, value in mode.registers.items() if key in static}
    for key in registers:
        _in_range(source, mode.name, static[key], mode.registers[key])
    for one in chosen:
        for key, value in mode.registers.items():
            if key in one.module.registers:
                base = register_window(source, one.region, one.module, key).base
                _in_range(source, mode.name, one.module.registers[key], value)
                registers[key] = _placed(one.module.registers[key], base, one.region.name, value)
    registers |= _routes(system, mode)
    beside = [one for one in chosen if one.region.registers and one.region.spec.loader is not LoaderKind.OVERLAY]
    overlays = tuple(Overlay(f"module_{one.name}") for one in beside)
    return Mode(
        name=mode.name,
        modules=tuple(one.name for one in chosen),
        registers=registers,
        overlays=overlays,
        streams=_mode_streams(system, mode, streams),
        doc=mode.doc,
        run=mode.run,
    )


def _in_range(source: Path, mode: str, register: Register, value: int) -> None:
    """Raise a fault for a value that a mode gives a register beyond its limits."""
    low = register.minimum or 0
    high = (1 << register.width) - 1 if register.maximum is None else register.maximum
    if not low <= value <= high:
        key = ("modes", mode, "registers", register.name)
        raise fault(source, key, f"{value} is outside min and max of {register.name}", f"{low} to {high}")


def _routes(system: System, mode: ModeSpec) -> dict[str, Register]:
    """The switch's registers, with the values of a mode."""
    if system.switch is None:
        return {}
    values = dict(route_values(system.switch, system.project.modes))[mode.name]
    found = _switch_registers(system.switch)
    return {name: replace(found[name], default=value) for name, value in values.items()}


def _switch_registers(switch: SwitchPlan) -> dict[str, Register]:
    """Registers of the switch in the order in which they are written, CONTROL last."""
    order = ", ".join(f"{number} {name}" for number, name in enumerate(switch.sources))
    found = {}
    for number, sink in enumerate(switch.sinks):
        doc = f"source of {sink}: {order}, {NONE:#x} none"
        offset = MUX + 4 * number
        found[register_name(sink)] = Register(register_name(sink), switch.window.base, offset, default=NONE, doc=doc)
    doc = "2 in the lowest bits commits the routes; the others number the set of routes"
    found[COMMIT] = Register(COMMIT, switch.window.base, CONTROL, access=Access.WO, default=UPDATE, doc=doc)
    return found


def _mode_streams(system: System, mode: ModeSpec, streams: Mapping[str, Stream]) -> dict[str, Stream]:
    """Streams that differ in a mode; a switch's stream names what it passes through, and stops when that changes."""
    found = {}
    for name, spec in mode.streams.items():
        if name not in streams:
            message, key = f"mode {mode.name} names the stream {name!r}", ("modes", mode.name, "streams", name)
            raise fault(system.project.source, key, message, did_you_mean(name, streams))
        shape = pixel_shape(spec.shape, streams[name].format) or streams[name].shape
        found[name] = replace(streams[name], shape=shape, dtype=spec.dtype or streams[name].dtype)
    for bus in system.switch.streams if system.switch else ():
        assert system.switch
        assert bus.dma
        chain = chain_of(system.switch, mode, bus.name)
        if chain:
            passed = [f"{region} ({mode.modules[region]})" if region in mode.modules else region for region in chain]
            region = chain[0] if bus.dma.sends else chain[-1]
            stream = found.get(bus.name, streams[bus.name])
            found[bus.name] = replace(stream, region=region, doc=f"through {', '.join(passed)}")
    return found


def _static_registers(system: System) -> dict[str, Register]:
    base = system.control.base
    found = {
        "cm_id": Register("cm_id", base, 0, access=Access.RO, doc="0x434D3031: the generated static part"),
        "cm_shape": Register("cm_shape", base, 4, access=Access.RO, doc="regions, interrupt lines"),
    }
    for bank in range(-(-len(system.lines) // 32)):
        found |= _interrupt_bank(base, bank, min(32, len(system.lines) - 32 * bank))
    if system.switch:
        found |= _switch_registers(system.switch)
    return found | dict(system.project.static.registers)


def _interrupt_bank(base: int, bank: int, lines: int) -> dict[str, Register]:
    """Status and enable registers of 32 interrupt lines, or fewer."""
    mask = (1 << lines) - 1
    status, enable = _bank_name("irq_status", bank), _bank_name("irq_enable", bank)
    doc = "interrupts that happened, write 1 to clear"
    at = IRQ_BANK * (bank + 1) if bank else IRQ_STATUS
    told = Register(enable, base, at + 4, default=mask, maximum=mask, doc="interrupts that are enabled")
    return {status: Register(status, base, at, access=Access.W1C, volatile=True, doc=doc), enable: told}


def _bank_name(name: str, bank: int) -> str:
    return f"{name}_{bank}" if bank else name


def _streams(system: System, answers: Answers) -> list[Stream]:
    found = []
    regions = {bus.name: region.name for region in system.regions for bus in region.streams}
    for bus in system.streams:
        if bus.dma is None:
            continue
        own, spec = answers.streams.get(bus.name, StreamAnswer()), bus.spec
        shape, dtype = pixel_shape(own.shape, spec.format) or spec.shape, own.dtype or spec.dtype
        if problem := frame_problem(bus, shape, dtype):
            raise BuildError(f"stream {bus.name}: {'; '.join(problem)}")
        direction, region = Direction(bus.dma.direction.value), regions.get(bus.name)
        told = Stream(bus.name, bus.name, direction, shape, dtype, own.slots or spec.slots, region, rate=spec.rate)
        found.append(replace(told, format=spec.format))
    return found


def _interrupt(system: System, name: str, bit: int) -> Interrupt:
    status = _bank_name("irq_status", bit // 32)
    return Interrupt(name, system.control.base, status=status, bit=bit % 32, acknowledge=True)


_KEY = re.compile(r"( *)(?:- )?([^\s:#][^:]*):")


def runtime_text(system: System, config: Config) -> str:
    """Write `config` in normal form; each comment is above the key that it is about."""
    notes = dict(_notes(system, config))
    lines: list[str] = []
    stack: list[tuple[int, str]] = []
    for line in dump(config).splitlines():
        found = _KEY.match(line)
        if found:
            depth = len(found[1])
            stack = [entry for entry in stack if entry[0] < depth]
            stack.append((depth, found[2].strip("\"'")))
            note = notes.get(".".join(key for _, key in stack))
            if note:
                lines.append(f"{found[1]}# {note}")
        lines.append(line)
    return "\n".join(lines)


def _notes(system: System, config: Config) -> Iterator[tuple[str, str]]:
    yield "config.default_mode", f"decide: the mode after start, one of {', '.join(config.modes)}"
    if config.overlays:
        yield "config.overlays", "decide: leave out where dts/system-user.dtsi is part of the board's own device tree"
    for name, stream in config.streams.items():
        if stream.shape is None:
            text = "decide: shape (one frame) and dtype; without them frames are flat bytes of the length that arrived"
        else:
            text = "decide: shape, dtype and slots of a frame"
        yield f"config.streams.{name}", text
    for region in system.regions:
        if not region.spec.decoupling:
            yield f"config.regions.{region.name}", "not decoupled: a load may disturb what is connected to it"
    for name, module in config.modules.items():
        if module.registers and all(register.default is None for register in module.registers.values()):
            yield f"config.modules.{name}", "decide: default: of registers that a mode should set when it is entered"
