# SPDX-License-Identifier: Apache-2.0
"""All rules over a planned system.

Every port of the top needs a package pin and an I/O standard, or write_bitstream stops (NSTD-1, UCIO-1).

Clocks of a region's modules: the build schema must name a source for each; none is connected by guess.
"""

from __future__ import annotations

from collections.abc import Iterator

from cm.design.check.block_design import check_block_design
from cm.design.check.floorplan import check_floorplan
from cm.design.errors import BuildError
from cm.design.hdl.axi_signals import aximm, axis
from cm.design.hdl.detect import LIKE, NOTHING_KNOWN
from cm.design.plan import block_design
from cm.design.plan.dma_engines import EngineKind
from cm.design.plan.pins import placements
from cm.design.plan.steps import clashes
from cm.design.plan.system import RegionPlan, System, used_clocks
from cm.design.project.source_position import Finding
from cm.design.runtime.answers import Answers
from cm.design.runtime.schema import bare_name, bare_windows, runtime_config
from cm.schema import SchemaError, dump, loads
from cm.schema.clock_rates import PLL, hertz, nearest, rate_problem, rounded


def check_clocks(system: System) -> Iterator[Finding]:
    """Yield a finding for each clock whose source is not named, and for buses on a clock other than the region's."""
    for region in system.regions:
        key = ("regions", region.name, "clocks")
        for port in sorted(region.spec.clocks.keys() - region.clocks.keys()):
            hint = f"clocks are {', '.join(region.clocks) or 'none'}"
            yield Finding("clocks", (*key, port), f"no module of {region.name} has a clock {port}", hint)
        for port, clock in region.clocks.items():
            if clock is None:
                message = f"the modules of {region.name} have a clock {port} beside the region's: what drives it?"
                hint = f"write clocks: {{{port}: CLOCK}} with one of {', '.join(system.project.clocks)}, or external"
                yield Finding("clocks", ("regions", region.name), message, hint)
            elif clock == "external":
                yield from _buses(region, port)


def _buses(region: RegionPlan, port: str) -> Iterator[Finding]:
    for interface in region.boundary.interfaces:
        connected = region.spec.interfaces.get(interface.name)
        if interface.clock != port or (connected and connected.connect in ("none", "external")):
            continue
        message = (
            f"{interface.name} runs on {port}, which comes from outside; its decoupler runs on {region.spec.clock}"
        )
        hint = f"give {port} one of clocks:, or put a crossing into the module"
        yield Finding("BD 41-237", ("regions", region.name, "clocks", port), message, hint)


def check_rates(system: System) -> Iterator[Finding]:
    """A finding for each clock that the processing system cannot give nearly enough: the manager would not load."""
    pll = PLL["ultrascale+" if system.platform.ultrascale else "7series"]
    for name in used_clocks(system):
        spec = system.project.clocks[name]
        there = rounded(pll, spec.rate)
        if problem := rate_problem(spec, there):
            hint = f"write rate: {nearest(pll, spec.rate)}, or tolerance: if another PLL of the board gives more"
            yield Finding("rate", ("clocks", name, "rate"), f"{problem}, with the I/O PLL at {hertz(pll)}", hint)


def check_pins(system: System) -> Iterator[Finding]:
    """A finding for each port without a pin, and for each impossible pin."""
    hint = "name pins of the board under pins:, or give both in a file of static: constraints"
    for fault in placements(system)[1]:
        rule, said = ("DRC UCIO-1", hint) if fault.missing else ("pins", "")
        yield Finding(rule, fault.key, fault.message, said)


def check_products(system: System) -> Iterator[Finding]:
    """A finding for each two products of the flow that would be one file."""
    for name, made in clashes(system):
        yield Finding("products", ("modules",), f"{' and '.join(made)} would both be {name}", "rename a module")


_HANDSHAKES = frozenset(
    spelling
    for protocol in (aximm(), axis())
    for spelling, name in protocol.spelled.items()
    if name.endswith(("VALID", "READY"))
)


def check_handshakes(system: System) -> Iterator[Finding]:
    """A finding for each signal of a handshake that belongs to no bus: without it no transfer ends."""
    for region in system.regions:
        for port in region.unused:
            word = port.name.lower().removesuffix("_i").removesuffix("_o").rpartition("_")[2]
            decided = port.name in region.spec.interfaces or not port.left.startswith((NOTHING_KNOWN, LIKE))
            if port.interface or decided or word not in _HANDSHAKES:
                continue
            message = f"{port.name} is of a handshake, and the rest of its bus was not found with it"
            hint = f"give all ports of the bus one beginning, or write {port.name}: {{connect: none}} if it is none"
            yield Finding("handshake", ("regions", region.name), message, hint)


def check_windows(system: System) -> Iterator[Finding]:
    """A note for each register window of which no registers are known, and for what register maps could not carry."""
    for name, module in system.project.modules.items():
        for note in module.register_notes:
            yield Finding("registers", ("modules", name, "register_map"), note, error=False)
    for one in system.implementations:
        for bus in bare_windows(system.project.source, one.region, one.module):
            name = bare_name(one.name, bus)
            message = f"no registers are known on {bus.interface.name}: its window is the memory {name}"
            some = bool(one.module.registers or one.module.memories)
            each = f"register_map: {{{bus.interface.name}: FILE}}, beside that of the other, has them by name"
            hint = each if some else "write registers: or register_map: to have them by name"
            yield Finding("registers", ("modules", one.module.name), message, hint, error=False)


def check_runtime(system: System) -> Iterator[Finding]:
    """A finding for all that the manager would refuse in the runtime schema, such as two registers of one name."""
    try:
        loads(dump(runtime_config(system, Answers())))
    except SchemaError as error:
        modules = {one.name: one.module.name for one in system.implementations}
        for problem in error.problems:
            key = [part for part in problem.key.split(".")[1:] if not part.startswith("mmio[")]
            hint = problem.hint
            if key[:1] == ["modules"]:
                key[1:2] = [modules.get(name, name) for name in key[1:2]]
            if problem.code == "name_clash":
                hint += "; in two regions at once, a module is written twice, with register names of its own"
            yield Finding("schema", tuple(key), problem.message, hint)


def check_sidebands(system: System) -> Iterator[Finding]:
    """A note for each stream into a region whose TUSER a DMA engine cannot drive: no picture ever begins."""
    for region in system.regions:
        for bus in region.streams:
            if bus.dma and bus.dma.sends and bus.dma.kind is not EngineKind.VDMA and "TUSER" in bus.interface.ports:
                message = f"{bus.interface.name} has TUSER, which its DMA engine leaves at 0"
                key = ("regions", region.name, "interfaces", bus.interface.name)
                yield Finding("TUSER", key, message, "video that begins with it wants connect: vdma", error=False)


def check_system(system: System) -> list[Finding]:
    """Return what Vivado would refuse and what a designer should know, in the order of the flow."""
    design = check_block_design(system, block_design.context(system))
    return [
        *check_products(system),
        *check_clocks(system),
        *check_rates(system),
        *check_windows(system),
        *check_runtime(system),
        *check_handshakes(system),
        *check_sidebands(system),
        *design,
        *check_floorplan(system),
        *check_pins(system),
    ]


def refuse_errors(system: System) -> None:
    """Raise BuildError with everything that would be refused."""
    errors = [finding.text(system.project.source) for finding in check_system(system) if finding.error]
    if errors:
        raise BuildError("this design would be refused:\n  " + "\n  ".join(errors))
