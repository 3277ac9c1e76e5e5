# SPDX-License-Identifier: Apache-2.0
"""Inspection: everything that can be said about a bitstream without knowing its purpose."""

from __future__ import annotations

from itertools import zip_longest

from cm.device.native import bitstream as native
from cm.formats.bitstream import frames
from cm.formats.bitstream.container import Image, Source, named, open_image, read_source
from cm.formats.bitstream.errors import BadContainer, UnknownDevice, WrongDevice
from cm.formats.bitstream.geometry import geometry_of
from cm.formats.bitstream.idcodes import Family, base_name, device_by_idcode, device_by_name, family_of
from cm.formats.bitstream.inspection_report import Report, Section
from cm.formats.bitstream.packets import Register, packet_events
from cm.formats.bitstream.stream_rules import Rules
from cm.frozen import replace
from cm.hashes import sha256


def _take(image: Image) -> tuple[Rules, native.Events, list[int]]:
    """Read a whole stream: the rules after its last event, the events that write frames, the lengths of its fills."""
    port, rules, writes, fills = native.PacketProcessor(), Rules(image.encrypted), native.Events(), []
    for event in packet_events(image, port):
        if event.kind in (native.FRAMES, native.MULTI):
            writes.append(event)
            continue
        rules.take(event)
        if event.kind == native.FILL:
            fills.append(event.count)
    rules.finish(port.phase, len(image.stream) // 4)
    return rules, writes, fills


def _identify(image: Image, rules: Rules) -> tuple[str | None, int | None, Family | None]:
    """Return device, IDCODE and family; refusals for none, several, or another than the header's."""
    part = image.header.part if image.header else None
    idcode = rules.idcodes[0] if rules.idcodes else None
    family = family_of(idcode, part)
    known = device_by_idcode(idcode) if idcode is not None else None
    if idcode is None and not rules.encrypted:
        rules.refuse(UnknownDevice, "no IDCODE is written: the device would not check that the bitstream is its own")
    elif family is None and (part or idcode is not None):
        found = ([] if idcode is None else [f"IDCODE {idcode:08X}"]) + ([f"part {part}"] if part else [])
        rules.refuse(UnknownDevice, f"{', '.join(found)}: neither 7-series nor UltraScale+")
    if len(set(rules.idcodes)) > 1:
        rules.refuse(WrongDevice, "sections for different devices: " + ", ".join(f"{x:08X}" for x in rules.idcodes))
    named = device_by_name(part) if part else None
    if known is not None and named is not None and known != named:
        rules.refuse(WrongDevice, f"the header says {part}, the IDCODE {idcode:08X} is that of {known.name}")
    return (known.name if known else base_name(part) if part else None), idcode, family


def _sections(image: Image, rules: Rules, writes: native.Events, family: Family | None) -> tuple[Section, ...]:
    result = []
    for sync, end in zip_longest(rules.syncs, rules.desyncs, fillvalue=len(image.stream) // 4):
        count = frames.frames_between(writes, family, sync, end) if family else 0
        result.append(Section(image.offset + 4 * sync, 4 * (end - sync), count))
    return tuple(result)


def inspect(source: Source) -> Report:
    """Read a bitstream whole and say what it is.

    `source` is a path or the file's bytes. Raises `BadContainer`, `Truncated` or `NoSync` where
    nothing can be said, OSError where a path cannot be read; all else stands in `Report.problems`.
    """
    with named(source):
        data = read_source(source)
        return inspect_image(open_image(data), data)


def inspect_image(image: Image, data: memoryview) -> Report:
    """`inspect` for a file that is open already; `data` is the whole file."""
    return replace(analyse(image), length=len(data), sha256=sha256(data))


def analyse(image: Image) -> Report:
    """Everything but the hash of the file and its length."""
    rules, writes, fills = _take(image)
    if image.rest:
        rules.refuse(BadContainer, f"{image.rest} bytes follow the last whole word")
    device, idcode, family = _identify(image, rules)
    looks_partial = not rules.registers & {Register.TIMER, Register.WBSTAR}
    partial = image.header.partial if image.header else looks_partial
    geometry = geometry_of(device) if partial else None  # a full image may write anything
    if family is not None and not rules.encrypted:
        rules.problems += [*frames.check_frames(writes, family), *frames.check_fills(fills, family)]
        rules.problems += frames.check_addresses(writes, family, geometry) if geometry else []
    return Report(
        container=image.container,
        header=image.header,
        device=device,
        idcode=idcode,
        family=family,
        partial=partial,
        looks_partial=looks_partial,
        sections=_sections(image, rules, writes, family),
        frames=frames.total_frames(writes, family) if family else 0,
        crc=rules.crc,
        footprint=frames.footprint(writes, family, geometry) if family else (),
        encrypted=rules.encrypted,
        compressed=native.MULTI in writes.kinds,
        length=len(image.stream),
        sha256="",
        problems=tuple(rules.problems),
    )
