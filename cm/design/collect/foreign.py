# SPDX-License-Identifier: Apache-2.0
"""Makes a configuration from the files of another flow: .hwh, full and partial bitstreams."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from cm.design.collect import handoff
from cm.design.collect.collected import Collected, Inputs, compile_overlays
from cm.design.collect.foreign_dma import engines, interrupts
from cm.design.collect.foreign_overlay import overlay
from cm.design.collect.handoff import Handoff
from cm.design.collect.images import Image, by_region, check_regions, footprint, to_bin
from cm.design.errors import BuildError
from cm.design.hdl.register_maps import identifier
from cm.design.platforms import platform_of
from cm.formats import hwh
from cm.schema import dump
from cm.schema.model import (
    Config,
    ConfigType,
    Decoupler,
    GpioLine,
    LoaderKind,
    Mode,
    Module,
    Overlay,
    Region,
    Register,
    StaticIdentity,
)

_HEAD = "# SPDX-License-Identifier: Apache-2.0\n# Written by cm build collect.\n"
_NAME_LENGTH = 64


def their_config(inputs: Inputs, name: str | None) -> Collected:
    """Return the configuration in normal form, with its files. BuildError if the files do not belong together."""
    whole = inputs.whole
    full = [image for image in inputs.images if not image.report.partial]
    partial = [image for image in inputs.images if image.report.partial]
    chosen = identifier(name or (whole.name if whole else (full or partial)[0].name))
    static = _one_full(full, whole)
    if partial:
        return _partial(inputs, chosen, static, partial)
    return _full(inputs, chosen, static)


def _one_full(full: list[Image], whole: Handoff | None) -> Image | None:
    named = [image for image in full if whole is not None and image.name == whole.name]
    if len(named or full) > 1:
        raise BuildError(f"several full bitstreams: {', '.join(i.path.name for i in full)}; give one at a time")
    return next(iter(named or full), None)


def _full(inputs: Inputs, name: str, static: Image | None) -> Collected:
    if static is None:
        raise BuildError("no bitstream was given: a configuration without one cannot be loaded")
    files = {f"{name}.bin": to_bin(static)}
    fields = _common(inputs, name, static.report.device, frozenset())
    config = Config(
        name=name,
        type=ConfigType.FULL,
        bitstream=Path(f"{name}.bin"),
        sha256=hashlib.sha256(files[f"{name}.bin"]).hexdigest(),
        modes={"default": Mode("default")},
        **fields,
    )
    return _finish(inputs, config, files, [])


def _partial(inputs: Inputs, name: str, static: Image | None, partial: list[Image]) -> Collected:
    whole = inputs.whole.design if inputs.whole else None
    groups = _named_groups(partial, whole)
    notes = check_regions(groups)
    regions = {region: _region(region, images, whole, len(groups)) for region, images in groups.items()}
    files = {f"{identifier(image.name)}.bin": to_bin(image) for image in partial}
    fields = _common(inputs, name, partial[0].report.device, frozenset(_region_instances(whole)))
    modules = {
        module.name: module
        for region, images in groups.items()
        for image in images
        for module in [_module(inputs, image, region, whole, files, fields["registers"])]
    }
    modes = {module.name: Mode(module.name, (module.name,)) for module in modules.values()}
    config = Config(name=name, type=ConfigType.PARTIAL, regions=regions, modules=modules, modes=modes, **fields)
    if static is not None:
        files[f"{name}_full.bin"] = to_bin(static)
        if static.report.user_id is not None:
            config = replace(config, static=StaticIdentity(user_id=static.report.user_id))
    bare = [region for region, found in regions.items() if not found.decoupler]
    notes += [
        f"region {region}: no register of the PL or GPIO line decouples it: write decoupler: if there is one"
        for region in bare
    ]
    return _finish(inputs, config, files, notes)


def _common(inputs: Inputs, name: str, device: str | None, regions: frozenset[str]) -> dict[str, Any]:
    """The parts of a configuration that come from the description of the whole design."""
    whole = inputs.whole
    fields: dict[str, Any] = {"device": device or (whole.device if whole else None)}
    fields["registers"] = {}
    if whole is not None:
        design = whole.design
        fields |= {"registers": handoff.static_registers(design, regions), "streams": handoff.streams(design)}
        fields["clocks"] = handoff.clocks(design)
        if hwh.windows(design):
            fields["interrupts"] = interrupts(design, platform_of(device or whole.device)).lines
            fields["overlays"] = (Overlay(f"{name}_static"),)
    return fields


def _region_instances(whole: hwh.Hwh | None) -> list[str]:
    return [name for name, module in whole.modules.items() if module.region] if whole else []


def _named_groups(partial: list[Image], whole: hwh.Hwh | None) -> dict[str, list[Image]]:
    """Group bitstreams by region; a region takes its name in the block design if all file names begin with it."""
    groups: dict[str, list[Image]] = {}
    for index, images in enumerate(by_region(partial)):
        names = [whole.modules[instance].name for instance in _region_instances(whole)] if whole else []
        fitting = [name for name in names if all(image.name.startswith(name) for image in images)]
        groups[identifier(max(fitting, key=len)) if fitting else f"prr{index}"] = images
    return groups


def _instance(region: str, whole: hwh.Hwh | None, count: int) -> str | None:
    """The block design's instance of a region."""
    instances = _region_instances(whole)
    if whole is None or not instances:
        return None
    named = [name for name in instances if identifier(whole.modules[name].name) == region]
    return named[0] if named else instances[0] if len(instances) == count == 1 else None


def _region(name: str, images: list[Image], whole: hwh.Hwh | None, count: int) -> Region:
    decoupler = _decoupler(name, whole, count)
    return Region(name=name, loader=LoaderKind.AUTO, decoupler=decoupler, footprint=footprint(images))


def _decoupler(region: str, whole: hwh.Hwh | None, count: int) -> Decoupler | None:
    found = [entry for entry in hwh.decouplers(whole) if entry.base is not None or entry.chip] if whole else []
    instance = _instance(region, whole, count)
    mine = [entry for entry in found if instance is not None and instance in entry.neighbours]
    if not mine and count == 1 and len(found) == 1:
        mine = found
    bits = {(entry.base, entry.offset, entry.bit, entry.chip, entry.line) for entry in mine}
    if len(bits) != 1:
        return None
    base, offset, bit, chip, line = bits.pop()
    return Decoupler(gpio=GpioLine(chip, line)) if base is None else Decoupler(base, offset, bit)


def _module(
    inputs: Inputs,
    image: Image,
    region: str,
    whole: hwh.Hwh | None,
    files: Mapping[str, bytes],
    static: Mapping[str, Register],
) -> Module:
    name = identifier(image.name)
    own = next((entry for entry in inputs.handoffs if entry.partial and entry.name == image.name), None)
    registers: dict[str, Register] = {}
    if own is not None:
        instance = _instance(region, whole, 1) if whole else None
        bases = [window.base for window in hwh.windows(whole) if window.instance == instance] if whole else []
        base = min(bases, default=0)
        registers = handoff.module_registers(own.design, base, region)
    registers = {_free(key, static): register for key, register in registers.items()}
    digest = hashlib.sha256(files[f"{name}.bin"]).hexdigest()
    return Module(name, region, Path(f"{name}.bin"), digest, registers=_renamed(registers))


def _free(name: str, taken: Mapping[str, Register]) -> str:
    """A register's name that the static part does not use."""
    return name if name not in taken else f"{name}_rm"[:_NAME_LENGTH]


def _renamed(registers: Mapping[str, Register]) -> dict[str, Register]:
    return {name: replace(register, name=name) for name, register in registers.items()}


def _finish(inputs: Inputs, config: Config, files: dict[str, bytes], notes: list[str]) -> Collected:
    sources: dict[str, str] = {}
    if inputs.whole is not None and config.overlays:
        platform = platform_of(config.device or inputs.whole.device)
        dma, lines = engines(inputs.whole.design, platform), interrupts(inputs.whole.design, platform)
        sources[f"{config.name}_static"] = overlay(inputs.whole.design, config, platform, dma, lines)
        notes = [*notes, *dma.notes, *handoff.limits(inputs.whole.design), *lines.notes]
    overlays, more = compile_overlays(sources)
    text = (_HEAD + dump(config)).encode()
    return Collected(config, {**files, **overlays, f"{config.name}.yaml": text}, (*notes, *more))
