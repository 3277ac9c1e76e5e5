# SPDX-License-Identifier: Apache-2.0
"""What must be true of a configuration beyond the syntax of its file."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from cm.schema.construct import IMAGE_KEYS, STATIC, Context
from cm.schema.model import (
    ITEM_BYTES,
    Config,
    ConfigType,
    Decoupler,
    GpioLine,
    Interrupt,
    Mode,
    Overlay,
    Region,
    Register,
    StaticIdentity,
    Stream,
)
from cm.schema.pictures import format_misfit, implied_encoding, misfit
from cm.schema.problems import KeyPath, did_you_mean
from cm.schema.rules_memories import check_memories
from cm.schema.rules_registers import check_registers, check_runs


def check_interrupts(config: Config, context: Context) -> None:
    """Report every interrupt of `config` that breaks a rule."""
    lines: dict[tuple[int | None, str | None], Interrupt] = {}
    for name, interrupt in config.interrupts.items():
        path: KeyPath = ("config", "interrupts", name)
        _check_line(interrupt, path, context)
        _check_status(interrupt, config, path, context)
        other = lines.setdefault((interrupt.base_address, interrupt.uio), interrupt)
        if other is not interrupt and not _apart(other, interrupt):
            message = f"interrupts {other.name} and {name} share a line and cannot be told apart"
            context.report(path, "interrupt_conflict", message, "give each its own bit of a status register")


def _apart(one: Interrupt, other: Interrupt) -> bool:
    told = None not in (one.status, one.bit, other.status, other.bit)
    return told and (one.status, one.bit) != (other.status, other.bit)


def _check_line(interrupt: Interrupt, path: KeyPath, context: Context) -> None:
    if interrupt.base_address is None and interrupt.uio is None:
        context.report(path, "missing_key", "which line?", "base_address of a register window, or uio")
    if interrupt.base_address is not None and interrupt.uio is not None:
        context.report((*path, "uio"), "name_clash", "base_address and uio both name the line", "keep one of them")


def _check_status(interrupt: Interrupt, config: Config, path: KeyPath, context: Context) -> None:
    if interrupt.status is None:
        for key, given in (("bit", interrupt.bit is not None), ("acknowledge", interrupt.acknowledge)):
            if given:
                context.report((*path, key), "missing_key", f"{key} of which register?", "status names it")
        return
    registers = {register.name: register for register in _registers(config)}
    if interrupt.status not in registers:
        hint = did_you_mean(interrupt.status, registers)
        message = f"there is no register {interrupt.status}"
        context.report((*path, "status"), "unknown_register", message, hint)
    elif interrupt.bit is None and interrupt.acknowledge:
        context.report((*path, "acknowledge"), "missing_key", "which bit is written?", "bit says which")
    elif interrupt.bit is not None and interrupt.bit >= registers[interrupt.status].width:
        width = registers[interrupt.status].width
        context.report((*path, "bit"), "value_range", f"bit {interrupt.bit} of {width} bits", f"0 to {width - 1}")


def _registers(config: Config) -> Iterable[Register]:
    yield from config.registers.values()
    for module in config.modules.values():
        yield from module.registers.values()
    for mode in config.modes.values():
        yield from mode.registers.values()


_TOP: KeyPath = ("config",)


def check_rules(config: Config, context: Context) -> None:
    """Report everything in `config` that breaks a rule."""
    _check_top(config, context)
    if config.static is not None:
        _check_static(config.static, context)
    _check_regions(config.regions, context)
    _check_modules(config, context)
    _check_overlays(config.overlays, (), _TOP, context)
    _check_streams(config.streams, {}, config, (*_TOP, "streams"), context)
    for mode in config.modes.values():
        _check_mode(mode, config, context)
    check_registers(config, context)
    check_runs(config, context)
    check_memories(config, context)
    check_interrupts(config, context)
    _check_blocks(config, context)


def _check_blocks(config: Config, context: Context) -> None:
    """Report what a block names and is not there."""
    streams = {name for found in (config.streams, *(mode.streams for mode in config.modes.values())) for name in found}
    for name, block in config.blocks.items():
        for key, code, named, known in (
            ("interrupts", "unknown_interrupt", block.interrupts, config.interrupts.keys()),
            ("streams", "unknown_stream", block.streams, streams),
            ("peers", "unknown_peer", block.peers, streams | config.blocks.keys()),
        ):
            for index, other in enumerate(named):
                if other not in known:
                    where: KeyPath = (*_TOP, "blocks", name, key, index)
                    context.report(where, code, f"there is no {other} among them", did_you_mean(other, known))


def _check_top(config: Config, context: Context) -> None:
    if not config.modes:
        context.report(_TOP, "missing_key", "modes is missing", "at least one mode, such as default")
    elif config.default_mode is not None and config.default_mode not in config.modes:
        message = f"there is no mode {config.default_mode}"
        context.report(
            (*_TOP, "default_mode"), "unknown_mode", message, did_you_mean(config.default_mode, config.modes)
        )
    if config.type is ConfigType.PARTIAL:
        _check_no_image(config, context)


def _check_no_image(config: Config, context: Context) -> None:
    """A partial configuration has no image of the whole device, so nothing can be said about one."""
    without = Config(config.name)
    for name in IMAGE_KEYS:
        if getattr(config, name) != getattr(without, name):
            hint = "type: full, or the same key at a module or region"
            message = f"{name} is of the image of the whole device, which a partial configuration does not have"
            context.report((*_TOP, name), "not_applicable", message, hint)


def _check_static(static: StaticIdentity, context: Context) -> None:
    path: KeyPath = (*_TOP, "static")
    if static.identity is None:
        return
    if static.base_address is None:
        message = "the static part's identity has no register to read it from"
        context.report((*path, "identity"), "missing_identity", message, "add base_address, and offset")
        return
    _check_aligned(static.base_address + static.offset, static.width, (*path, "offset"), context)
    if static.identity >> static.width:
        message = f"{static.identity:#x} does not fit the identity register"
        context.report((*path, "identity"), "value_range", message, f"at most {static.width} bits")


def _check_regions(regions: Mapping[str, Region], context: Context) -> None:
    decouplers: dict[tuple[int, int] | GpioLine, str] = {}
    identities: dict[int, str] = {}
    for name, region in regions.items():
        path: KeyPath = (*_TOP, "regions", name)
        if name == STATIC:
            context.report(
                path, "name_clash", "static is everything outside the regions", "give the region another name"
            )
        _check_footprint(region, path, context)
        if (cut := region.decoupler) is not None:
            _check_decoupler(cut, (*path, "decoupler"), context)
            other = decouplers.setdefault(cut.gpio or (cut.base_address + cut.offset, cut.bit), name)
            _report_shared(
                "decoupler line" if cut.gpio else "decoupler bit", other, name, (*path, "decoupler"), context
            )
        if (ident := region.identity) is not None:
            address = ident.base_address + ident.offset
            _check_aligned(address, ident.width, (*path, "identity", "offset"), context)
            other = identities.setdefault(address, name)
            _report_shared("identity register", other, name, (*path, "identity"), context)


def _check_decoupler(decoupler: Decoupler, path: KeyPath, context: Context) -> None:
    _check_aligned(decoupler.base_address + decoupler.offset, decoupler.width, (*path, "offset"), context)
    if decoupler.bit >= decoupler.width:
        message = f"bit {decoupler.bit} of a register of {decoupler.width} bits"
        context.report((*path, "bit"), "value_range", message, f"0 to {decoupler.width - 1}")

    for index, step in enumerate(decoupler.sequence):
        where = (*path, "sequence", index)
        _check_aligned(decoupler.base_address + decoupler.offset + step.offset, decoupler.width, where, context)
        for key, value in (("cut", step.cut), ("couple", step.couple), ("mask", step.mask or 0)):
            if value >> decoupler.width:
                message = f"{value:#x} does not fit a register of {decoupler.width} bits"
                context.report((*where, key), "value_range", message, f"at most {decoupler.width} bits")


def _report_shared(what: str, other: str, name: str, path: KeyPath, context: Context) -> None:
    if other != name:
        context.report(path, "region_conflict", f"region {other} has the same {what}", "one for each region")


def _check_aligned(address: int, width: int, path: KeyPath, context: Context) -> None:
    if address % (width // 8):
        hint = f"a multiple of {width // 8}"
        context.report(path, "misaligned_offset", f"address {address:#x} of an access of {width} bits", hint)


def _check_footprint(region: Region, path: KeyPath, context: Context) -> None:
    for index, frames in enumerate(region.footprint):
        if frames.column_first > frames.column_last:
            message = f"first column {frames.column_first} is after the last, {frames.column_last}"
            context.report((*path, "footprint", index, "columns"), "value_range", message, "[first, last]")


def _check_modules(config: Config, context: Context) -> None:
    values: dict[tuple[str, int], str] = {}
    for name, module in config.modules.items():
        path: KeyPath = (*_TOP, "modules", name)
        region = config.regions.get(module.region)
        if region is None:
            _report_region(module.region, config.regions, (*path, "region"), context)
            continue
        if module.identity is None:
            continue
        here = (*path, "identity")
        if region.identity is None:
            message = f"region {region.name} has no identity register to read it from"
            context.report(here, "missing_identity", message, f"add identity to region {region.name}")
            continue
        if module.identity >> region.identity.width:
            message = f"{module.identity:#x} does not fit the identity register"
            context.report(here, "value_range", message, f"at most {region.identity.width} bits")
        other = values.setdefault((region.name, module.identity), name)
        if other != name:
            hint = "one value per module of a region"
            context.report(here, "duplicate_identity", f"module {other} has the same identity", hint)


def _report_region(name: str, regions: Iterable[str], path: KeyPath, context: Context) -> None:
    context.report(path, "unknown_region", f"there is no region {name}", did_you_mean(name, regions))


def _check_mode(mode: Mode, config: Config, context: Context) -> None:
    path: KeyPath = (*_TOP, "modes", mode.name)
    taken: dict[str, str] = {}
    for index, name in enumerate(mode.modules):
        here = (*path, "modules", index)
        if name not in config.modules:
            hint = did_you_mean(name, config.modules)
            context.report(here, "unknown_module", f"there is no module {name}", hint)
            continue
        region = config.modules[name].region
        other = taken.setdefault(region, name)
        if index != mode.modules.index(name):
            context.report(here, "duplicate_name", f"module {name} is here twice", "name it once")
        elif other != name:
            message = f"modules {other} and {name} both fit region {region}"
            context.report(here, "region_conflict", message, "one module per region in a mode")
    _check_overlays(mode.overlays, config.overlays, path, context)
    _check_streams(mode.streams, config.streams, config, (*path, "streams"), context)


def _check_overlays(overlays: tuple[Overlay, ...], under: tuple[Overlay, ...], path: KeyPath, context: Context) -> None:
    seen = {overlay.name for overlay in under}
    for index, overlay in enumerate(overlays):
        if overlay.name in seen:
            message = f"overlay {overlay.name} is applied already"
            context.report((*path, "overlays", index), "duplicate_name", message, "name it once")
        seen.add(overlay.name)


def _check_streams(
    streams: Mapping[str, Stream], base: Mapping[str, Stream], config: Config, path: KeyPath, context: Context
) -> None:
    """`base` holds the configuration's streams, already checked, if `streams` are those of a mode."""
    channels: dict[str, str] = {}
    for name, stream in streams.items():
        other = channels.setdefault(stream.channel, name)
        if base.get(name) == stream and base.get(other) == streams[other]:
            continue
        if stream.region is not None and stream.region not in config.regions:
            _report_region(stream.region, config.regions, (*path, name, "region"), context)
        if other != name:
            message = f"streams {other} and {name} are both on channel {stream.channel}"
            context.report((*path, name), "channel_conflict", message, "one stream per channel")
        _check_length(stream, (*path, name), context)
        _check_picture(stream, (*path, name), context)


def _check_length(stream: Stream, path: KeyPath, context: Context) -> None:
    """A frame is one transfer: an engine ends a packet with each, and a receiver takes one for each."""
    size = math.prod(stream.shape) * ITEM_BYTES[stream.dtype] if stream.shape else stream.slot_bytes or 0
    if stream.max_length is not None and size > stream.max_length:
        message = f"a frame has {size} bytes, and the engine moves {stream.max_length} at most in one transfer"
        key = "shape" if stream.shape else "slot_bytes"
        context.report((*path, key), "too_long", message, "smaller frames, or a design with a wider length register")


def _check_picture(stream: Stream, path: KeyPath, context: Context) -> None:
    """Pixels of the encoding are as long as those of the frames."""
    if stream.format is not None:
        problem = format_misfit(stream.format, stream.shape, stream.dtype)
        if problem:
            context.report((*path, "format"), "encoding_mismatch", problem, "shape: [rows, columns], and dtype uint8")
        if stream.encoding is not None:
            hint = "leave it out: bridges pass on rgb8"
            context.report((*path, "encoding"), "not_applicable", "format says what a pixel is", hint)
        return
    if stream.encoding is None:
        return
    problem = misfit(stream.encoding, stream.shape, ITEM_BYTES[stream.dtype])
    if problem:
        implied = implied_encoding(stream.shape, stream.dtype)
        hint = f"{implied} would be" if implied else "shape: [rows, columns] or [rows, columns, channels]"
        context.report((*path, "encoding"), "encoding_mismatch", problem, hint)
