# SPDX-License-Identifier: Apache-2.0
"""Makes a configuration from the files of another flow: .hwh, full and partial bitstreams; and its static overlay."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from cm.design.collect import handoff
from cm.design.collect.collected import HEAD, Collected, Inputs, compile_overlays
from cm.design.collect.foreign_dma import PS_CLOCKS, Engines, ForeignInterrupts, engines, interrupts, stream_names
from cm.design.collect.handoff import Handoff
from cm.design.collect.images import Image, by_region, check_regions, footprint, to_bin
from cm.design.errors import BuildError
from cm.design.generate.dma_nodes import ClockInput, Tree, pl_clock
from cm.design.platforms import Platform, platform_of
from cm.design.render import Renderer
from cm.formats import hwh
from cm.formats.importers import blocks_of
from cm.formats.importers.registers import decoupler_of
from cm.formats.registers import identifier
from cm.hashes import sha256
from cm.schema import dump
from cm.schema.model import (
    Config,
    ConfigType,
    Decoupler,
    LoaderKind,
    Mode,
    Module,
    Overlay,
    Region,
    StaticIdentity,
)

_NAME_LENGTH = 64


def their_config(inputs: Inputs, name: str | None) -> Collected:
    """Return the configuration in normal form, with its files. BuildError if the files do not belong together."""
    whole, notes = inputs.whole, list[str]()
    full = [image for image in inputs.images if not image.report.partial]
    partial = [image for image in inputs.images if image.report.partial]
    chosen = identifier(name or (whole.name if whole else (full or partial)[0].name))
    static = _one_full(full, whole)
    if partial:
        config = _described(chosen, partial[0], whole, notes)
        config, files = _with_modules(config, inputs, partial, static, notes)
    elif static is not None:
        config, files = _with_image(_described(chosen, static, whole, notes), static)
    else:
        raise BuildError("no bitstream was given: a configuration without one cannot be loaded")
    sources = _overlay_of(whole, config, notes) if whole and config.overlays else {}
    overlays, more = compile_overlays(sources)
    text = (HEAD + dump(config)).encode()
    return Collected(config, {**files, **overlays, f"{config.name}.yaml": text}, (*notes, *more))


def _one_full(full: list[Image], whole: Handoff | None) -> Image | None:
    named = [image for image in full if whole is not None and image.name == whole.name]
    if len(named or full) > 1:
        raise BuildError(f"several full bitstreams: {', '.join(i.path.name for i in full)}; give one at a time")
    return next(iter(named or full), None)


def _described(name: str, image: Image, whole: Handoff | None, notes: list[str]) -> Config:
    """The parts of a configuration that come from the description of the whole design."""
    if whole is None:
        return Config(name, device=image.report.device)
    design, device = whole.design, image.report.device or whole.device
    registers, memories = handoff.registers(design, notes)
    found = Config(
        name,
        device=device,
        registers=registers,
        memories=memories,
        streams=handoff.streams(design),
        clocks=handoff.clocks(design),
    )
    if not hwh.windows(design):
        return found
    lines, names = interrupts(design, platform_of(device)).lines, stream_names(hwh.dma_channels(design), design)
    prefixes = {instance: module.name for instance, module in design.modules.items()}
    blocks = {block.name: block for block in blocks_of(design, lines, found.streams, names, prefixes)}
    return replace(found, blocks=blocks, interrupts=lines, overlays=(Overlay(f"{name}_static"),))


def _overlay_of(whole: Handoff, config: Config, notes: list[str]) -> dict[str, str]:
    platform = platform_of(config.device or whole.device)
    dma, lines = engines(whole.design, platform), interrupts(whole.design, platform)
    notes += [*dma.notes, *handoff.limits(whole.design), *lines.notes]
    if dma.polled.words or lines.controllers:
        notes.append("some interrupts go to an axi_intc or nowhere (PYNQ polls): the board needs the module cm_intc")
    return {f"{config.name}_static": overlay(whole.design, config, platform, dma, lines)}


def overlay_of(
    design: hwh.Hwh, config: Config, names: Mapping[hwh.DmaChannel, str], notes: list[str]
) -> dict[str, bytes]:
    """The overlay of a configuration that was imported: ``<config>.dtbo``, or without dtc its source."""
    platform = platform_of(config.device or "")
    dma, lines = engines(design, platform, names), interrupts(design, platform)
    found, more = compile_overlays({config.name: overlay(design, config, platform, dma, lines)})
    notes += [*dma.notes, *lines.notes, *more]
    return found


def _with_image(config: Config, image: Image) -> tuple[Config, dict[str, bytes]]:
    """A full configuration, and its file."""
    file, data = f"{config.name}.bin", to_bin(image)
    modes = {"default": Mode("default")}
    digest = sha256(data)
    return replace(config, type=ConfigType.FULL, bitstream=Path(file), sha256=digest, modes=modes), {file: data}


def _by_name(images: list[Image]) -> dict[str, Image]:
    """By the names of their modules. BuildError if two have the same."""
    found: dict[str, Image] = {}
    for image in images:
        first = found.setdefault(identifier(image.name), image)
        if first is not image:
            raise BuildError(f"{first.path} and {image.path} are both module {identifier(image.name)}: rename one")
    return found


def _with_modules(
    config: Config, inputs: Inputs, partial: list[Image], static: Image | None, notes: list[str]
) -> tuple[Config, dict[str, bytes]]:
    """A partial configuration, and its files."""
    whole = inputs.whole.design if inputs.whole else None
    groups = _named_groups(partial, whole)
    notes += check_regions(groups)
    files = {f"{name}.bin": to_bin(image) for name, image in _by_name(partial).items()}
    regions, modules = {}, {}
    for name, images in groups.items():
        decoupler = _decoupler(name, whole, len(groups))
        regions[name] = Region(name, LoaderKind.AUTO, None, decoupler, footprint(images))
        if decoupler is None:
            notes.append(
                f"region {name}: no register of the PL or GPIO line decouples it: write decoupler: if there is one"
            )
        for image in images:
            module = _module(inputs, image, name, whole, config, files, notes)
            modules[module.name] = module
    modes = {name: Mode(name, (name,)) for name in modules}
    config = replace(config, regions=regions, modules=modules, modes=modes)
    if static is not None:
        files[f"{config.name}_full.bin"] = to_bin(static)
        if static.report.user_id is not None:
            config = replace(config, static=StaticIdentity(user_id=static.report.user_id))
    return config, files


def _regions_of(whole: hwh.Hwh | None) -> list[hwh.ModuleInstance]:
    return [module for module in whole.modules.values() if module.region] if whole else []


def _named_groups(partial: list[Image], whole: hwh.Hwh | None) -> dict[str, list[Image]]:
    """Group bitstreams by region; a region takes its name in the block design if all file names begin with it."""
    groups: dict[str, list[Image]] = {}
    for index, images in enumerate(by_region(partial)):
        names = [module.name for module in _regions_of(whole)]
        fitting = [name for name in names if all(image.name.startswith(name) for image in images)]
        groups[identifier(max(fitting, key=len)) if fitting else f"prr{index}"] = images
    return groups


def _instance(region: str, whole: hwh.Hwh | None, count: int) -> str | None:
    """The block design's instance of a region; the only one for the only one of `count`, whatever its name."""
    found = _regions_of(whole)
    named = [module for module in found if identifier(module.name) == region]
    return next((module.instance for module in named or (found if len(found) == count == 1 else [])), None)


def _decoupler(region: str, whole: hwh.Hwh | None, count: int) -> Decoupler | None:
    found = [entry for entry in hwh.decouplers(whole) if decoupler_of(entry)] if whole else []
    instance = _instance(region, whole, count)
    mine = [entry for entry in found if instance is not None and instance in entry.neighbours]
    if not mine and len(found) == count == 1:
        mine = found
    bits = {decoupler_of(entry) for entry in mine}
    return bits.pop() if len(bits) == 1 else None


def _module(
    inputs: Inputs,
    image: Image,
    region: str,
    whole: hwh.Hwh | None,
    config: Config,
    files: dict[str, bytes],
    notes: list[str],
) -> Module:
    """A module; a register of its own description that has the name of a static one gets ``_rm``."""
    name = identifier(image.name)
    own = next((entry for entry in inputs.handoffs if entry.partial and entry.name == image.name), None)
    registers, memories = {}, {}
    if own is not None:
        instance = _instance(region, whole, 1)
        bases = [window.base for window in hwh.windows(whole) if window.instance == instance] if whole else []
        described, blocks = handoff.registers(own.design, notes, min(bases, default=0), region)
        for key, register in described.items():
            free = key if key not in config.registers else f"{key}_rm"[:_NAME_LENGTH]
            registers[free] = replace(register, name=free)
        for key, memory in blocks.items():
            free = key if key not in config.memories else f"{key}_rm"[:_NAME_LENGTH]
            memories[free] = replace(memory, name=free)
    digest = sha256(files[f"{name}.bin"])
    return Module(name, region, Path(f"{name}.bin"), digest, registers=registers, memories=memories)


@dataclass(frozen=True, slots=True)
class Bridge:
    """A DFX decoupler with registers of its own, as the kernel's driver xlnx,pr-decoupler needs it."""

    label: str
    base: int
    size: int
    clock: str


def overlay(design: hwh.Hwh, config: Config, platform: Platform, dma: Engines, lines: ForeignInterrupts) -> str:
    """The source of the overlay."""
    decouplers = {bridge.base: bridge for bridge in bridges(design)}
    context = {
        "name": config.name,
        "dt": Tree(platform),
        "clocks": [ClockInput(c.name, _phandle(c.name), c.rate) for c in hwh.clocks(design)],
        "controllers": list(lines.controllers.values()),
        "polled": dma.polled,
        "windows": list(_windows(design, lines)),
        "fixed_clocks": dma.fixed_clocks,
        "engines": dma.found,
        "streams": dma.streams,
        "bridges": list(decouplers.values()),
        "regions": {
            region.name: decouplers.get(region.decoupler.base_address) if region.decoupler else None
            for region in config.regions.values()
        },
    }
    return Renderer(Path("/"), Path("/"), "Written by cm build collect.").render("collected.dtso.j2", context)


def bridges(design: hwh.Hwh) -> Iterator[Bridge]:
    """Decouplers whose registers the processor reaches, and whose clock it gives."""
    sizes = {window.instance: window.size for window in hwh.windows(design)}
    for found in hwh.decouplers(design):
        if found.base is None or found.driver != found.instance or found.instance not in sizes:
            continue
        clock = _clock_of(design.modules[found.instance])
        if clock is not None:
            label = f"{identifier(found.instance)}_bridge"
            yield Bridge(label, found.base, sizes[found.instance], clock)


def _clock_of(module: hwh.ModuleInstance) -> str | None:
    port = module.ports.get("aclk") or module.ports.get("s_axi_aclk")
    ends = [end.port for end in port.connections] if port else []
    return next((PS_CLOCKS[name] for name in ends if name in PS_CLOCKS), None)


def _phandle(name: str) -> str:
    """The phandle of a clock by its name in the runtime schema, fclk0 or pl0."""
    return pl_clock(name.startswith("fclk"), int(name[-1]))


def _windows(design: hwh.Hwh, lines: ForeignInterrupts) -> Iterator[dict[str, Any]]:
    """Windows for user space: all but those of DMA engines and interrupt controllers, each address once."""
    engines = {*(channel.instance for channel in hwh.dma_channels(design)), *lines.controllers}
    found = {window.base: window for window in hwh.windows(design) if window.instance not in engines}
    for window in found.values():
        if window.instance in design.modules:
            yield {
                "name": identifier(design.modules[window.instance].name).replace("_", "-"),
                "base": window.base,
                "size": window.size,
                "line": lines.nodes.get(window.instance),
            }
