# SPDX-License-Identifier: Apache-2.0
"""The IPs of a block design as the runtime schema's blocks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from cm.formats import hwh as handoff
from cm.formats.hwh import DmaChannel, Hwh
from cm.formats.registers import UniqueNames, identifier
from cm.frozen import replace
from cm.schema.model import Block, Interrupt, Stream


def blocks_of(
    hwh: Hwh,
    interrupts: Mapping[str, Interrupt],
    streams: Mapping[str, Stream],
    channels: Mapping[DmaChannel, str],
    prefixes: Mapping[str, str],
) -> Iterator[Block]:
    """What the processor sees, and what streams pass through, each with where its own streams lead to.

    `channels`: the streams' names. `prefixes`: what registers' names begin with, by instance. What is in a region is
    its modules'.
    """
    names = UniqueNames(streams)  # peers are of either kind
    found = {instance: list(_windows(hwh, instance, names, interrupts, prefixes)) for instance in hwh.modules}
    through = {end for instance in hwh.modules for end, _ in handoff.stream_ends(hwh, instance)}
    for instance, module in hwh.modules.items():
        if not found[instance] and (instance in through or handoff.stream_ends(hwh, instance)):
            found[instance] = [Block(names.take(identifier(instance)), vlnv=module.vlnv)]
    sinks = {(channel.instance, channel.direction): name for channel, name in channels.items() if name in streams}
    for instance, (first, *others) in ((instance, blocks) for instance, blocks in found.items() if blocks):
        own = tuple(name for (owner, _), name in sinks.items() if owner == instance)
        ends = handoff.stream_ends(hwh, instance)
        peers = [sinks.get((end, "s2mm")) if "S2MM" in port else found[end][0].name for end, port in ends]
        yield replace(first, streams=own, peers=tuple(dict.fromkeys(filter(None, peers))))
        yield from others


def _windows(
    hwh: Hwh, instance: str, names: UniqueNames, interrupts: Mapping[str, Interrupt], prefixes: Mapping[str, str]
) -> Iterator[Block]:
    module, prefix = hwh.modules[instance], f"{identifier(prefixes[instance])}_"
    places = {window.base: window for window in (*handoff.windows(hwh), *handoff.memories(hwh))}  # a RAM may be in both
    for window in places.values():
        if window.instance == instance and not module.region:
            lines = tuple(line.name for line in interrupts.values() if line.base_address == window.base)
            name = names.take(identifier(instance))
            yield Block(name, window.base, window.size, module.vlnv, prefix, interrupts=lines)
