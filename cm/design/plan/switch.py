# SPDX-License-Identifier: Apache-2.0
"""The stream switch between regions: the streams that it connects, and the register values of a mode's routes.

Registers are those of PG085 ("MI_MUX[0-15] Register", "Control Register"): one for each sink selects its source, and
a write to CONTROL commits them. Ends are named ``region.interface``, or as the switch's own streams.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

from cm.design.hdl.model import Interface, Mode
from cm.design.plan.addresses import Window
from cm.design.plan.streams import dma_width, stream_bus
from cm.design.plan.system import RegionPlan, StreamBus, SwitchPlan
from cm.design.project.model import ModeSpec, Project, RegionSpec
from cm.design.project.source_position import fault
from cm.schema.problems import KeyPath, did_you_mean

MAX_ENDS = 16  # on either side (PG085, "Switch Properties")
CONTROL, MUX = 0x000, 0x040
UPDATE, NONE = 2, 0x8000_0000
COMMIT = "route_update"  # the name of CONTROL in the runtime schema


def switch_width(project: Project, ends: Iterable[Interface]) -> int:
    """Bits of the switch's TDATA: those of the widest stream of the regions, rounded up to a width of DMA engines."""
    return max((dma_width(interface.data_width or 8) for interface in ends), default=8 if project.switch else 0)


def own_streams(project: Project, width: int) -> tuple[StreamBus, ...]:
    """The switch's streams from and to memory, with their channels."""
    spec = project.switch
    assert spec is not None
    region = RegionSpec("switch", spec.clock)
    ends = [(name, Mode.SLAVE, given) for name, given in spec.inputs.items()]
    ends += [(name, Mode.MASTER, given) for name, given in spec.outputs.items()]
    return tuple(stream_bus(project, region, _end(name, mode, width), given, spec.clock) for name, mode, given in ends)


def _end(name: str, mode: Mode, width: int) -> Interface:
    """The end of a DMA engine's stream, described like a region's interface of the switch's width."""
    widths = {"TVALID": 1, "TREADY": 1, "TLAST": 1, "TDATA": width, "TKEEP": width // 8}
    return Interface(name, "axis", mode, {signal: f"{name}_{signal.lower()}" for signal in widths}, widths=widths)


def plan_switch(
    project: Project, regions: tuple[RegionPlan, ...], window: Window, own: tuple[StreamBus, ...]
) -> SwitchPlan:
    """Plan the switch and number its ends: its own streams first, then the regions' in order."""
    spec = project.switch
    assert spec is not None
    named = {bus.name: bus for bus in own}
    for region in regions:
        for bus in region.streams:
            if bus.switched:
                _check_clock(project, region, bus)
                named[f"{region.name}.{bus.interface.name}"] = bus
    # an input of the switch stands for a region's slave: it goes into the switch, as a region's master does
    sources = {n: b for n, b in named.items() if (b.interface.mode is Mode.SLAVE) == (b in own)}
    sinks = {n: b for n, b in named.items() if n not in sources}
    for what, found in (("sources", sources), ("sinks", sinks)):
        if not 1 <= len(found) <= MAX_ENDS:
            message = f"the switch has {len(found)} {what}"
            hint = f"it has 1 to {MAX_ENDS}: interfaces with connect: switch, inputs: and outputs: of the switch"
            raise fault(project.source, ("switch",), message, hint)
    width = max(bus.width for bus in named.values())
    plan = SwitchPlan(spec.clock, window, width, own, sources, sinks)
    for mode in project.modes.values():
        _check_routes(project, mode, plan)
    return plan


def _check_clock(project: Project, region: RegionPlan, bus: StreamBus) -> None:
    assert project.switch is not None
    clock = region.clock_of(bus.interface)
    if clock != project.switch.clock:
        key: KeyPath = ("regions", region.name, "interfaces", bus.interface.name, "connect")
        message = f"{region.name} runs on {clock}, the switch on {project.switch.clock}"
        raise fault(project.source, key, message, "all ends of the switch run on its clock")


def check_switched(project: Project, region: RegionSpec, interface: Interface) -> None:
    """Raise the faults of an interface with ``connect: switch``."""
    key: KeyPath = ("regions", region.name, "interfaces", interface.name, "connect")
    who = f"{region.name}.{interface.name}"
    if project.switch is None:
        raise fault(project.source, key, f"{who} goes to the switch, and there is none", "write switch: at the top")
    if not interface.data_width:
        raise fault(project.source, key, f"{who} has no TDATA of known width", "write connect: external")
    if interface.mode is Mode.MASTER and "TLAST" not in interface.ports:
        message = f"{who} has no TLAST: the switch could not tell where a packet ends"
        raise fault(project.source, key, message, "give it one, or connect: dma")


def _check_routes(project: Project, mode: ModeSpec, plan: SwitchPlan) -> None:
    taken: dict[str, str] = {}
    for sink, source in mode.routes.items():
        key: KeyPath = ("modes", mode.name, "routes", sink)
        if sink not in plan.sinks:
            raise fault(project.source, key, f"the switch has no sink {sink!r}", did_you_mean(sink, plan.sinks))
        if source not in plan.sources:
            raise fault(project.source, key, f"the switch has no source {source!r}", did_you_mean(source, plan.sources))
        if source in taken:
            hint = "a source goes to one sink (PG085): insert a module with two output streams"
            raise fault(project.source, key, f"{source} goes to {taken[source]} already", hint)
        taken[source] = sink


def register_name(sink: str) -> str:
    """The name of a sink's register in the runtime schema."""
    return f"route_{sink.replace('.', '_')}"


def route_values(plan: SwitchPlan, modes: Mapping[str, ModeSpec]) -> Iterator[tuple[str, dict[str, int]]]:
    """Yield each mode with the values of the switch's registers, REG_UPDATE last.

    Bits above REG_UPDATE are reserved and ignored by the hardware; here they number the sets of routes, so that a
    manager that writes only changed values writes the update with every set.
    """
    numbers: dict[tuple[tuple[str, str], ...], int] = {}
    order = list(plan.sources)
    for name, mode in modes.items():
        number = numbers.setdefault(tuple(sorted(mode.routes.items())), len(numbers) + 1)
        values = {sink: order.index(mode.routes[sink]) if sink in mode.routes else NONE for sink in plan.sinks}
        yield name, {register_name(sink): value for sink, value in values.items()} | {COMMIT: UPDATE | number << 8}


def chain_of(plan: SwitchPlan, mode: ModeSpec, stream: str) -> list[str]:
    """The regions that a stream of the switch passes through in a mode, in order; possibly none."""
    source_of, found = dict(mode.routes), []
    sink_of = {source: sink for sink, source in source_of.items()}
    end = sink_of.get(stream) if stream in plan.sources else source_of.get(stream)
    forth = stream in plan.sources
    while end is not None and "." in end and end.partition(".")[0] not in found:
        region = end.partition(".")[0]
        found.append(region)
        step, ends = (sink_of, plan.sources) if forth else (source_of, plan.sinks)
        end = next((step[name] for name in ends if name.startswith(f"{region}.") and name in step), None)
    return found if forth else found[::-1]
