# SPDX-License-Identifier: Apache-2.0
"""Hypothesis strategies for valid configurations (`configs`), for every test that needs some."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

from hypothesis import strategies as st

from cm.schema.model import (
    Access,
    BitField,
    Clock,
    Config,
    ConfigType,
    Decoupler,
    Direction,
    FrameRange,
    Identity,
    Interrupt,
    LoaderKind,
    Memory,
    Mode,
    Module,
    Overlay,
    Region,
    Register,
    Stream,
)
from cm.schema.pictures import CameraInfo

DTYPES = ("bool", "int8", "uint8", "int16", "uint16", "float32", "complex128")

# plain text strategies: from_regex is several times slower, and there are many names in a configuration
names = st.text("aZ0_-", max_size=3).map(lambda tail: f"_{tail}")
docs = st.sampled_from(["", "a: b # c", "0o17", "no", "two\nlines\n"]) | st.text(max_size=5)
paths = st.text("ab. /", max_size=8).map(lambda middle: f"x{middle}.bit")
sums = st.sampled_from(["0" * 64, "0123456789abcdef" * 4])
addresses = st.integers(0, (1 << 32) - 1).map(lambda value: value << 12)

_WHOLE = tuple(kind for kind in LoaderKind if kind is not LoaderKind.AUTO)  # the loader of a whole device must be given


def maybe(strategy: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    """None, or what `strategy` gives."""
    return st.none() | strategy


def frozen(items: list[Any]) -> MappingProxyType[str, Any]:
    """Things with a name, by name."""
    return MappingProxyType({item.name: item for item in items})


@st.composite
def bit_fields(draw: st.DrawFn, width: int) -> MappingProxyType[str, BitField]:
    """Fields of a register of `width` bits that do not overlap."""
    edges = sorted(draw(st.sets(st.integers(0, width), max_size=3)))
    found = []
    for name, low, high in zip(draw(distinct(len(edges))), edges, edges[1:], strict=False):
        values = draw(st.dictionaries(names, st.integers(0, (1 << (high - low)) - 1), max_size=1))
        found.append(BitField(name, low, high - low, draw(docs), MappingProxyType(values)))
    return frozen(found)


def distinct(count: int) -> st.SearchStrategy[list[str]]:
    """`count` names, no two the same."""
    return st.lists(names, min_size=count, max_size=count, unique=True)


@st.composite
def registers(draw: st.DrawFn, name: str, base: int, offset: int, region: str | None) -> Register:
    """A register at `base` and `offset`, a multiple of 8."""
    width = draw(st.sampled_from([8, 16, 32, 64]))
    low, default, high = sorted(draw(st.tuples(*[st.integers(0, (1 << width) - 1)] * 3)))
    access = draw(st.sampled_from(Access))
    return Register(
        name=name,
        base_address=base,
        offset=offset,
        width=width,
        access=access,
        default=draw(maybe(st.just(default))) if access in (Access.RW, Access.WO) else None,
        reset=draw(maybe(st.integers(0, (1 << width) - 1))),
        minimum=draw(maybe(st.just(low))),
        maximum=draw(maybe(st.just(high))),
        fields=draw(bit_fields(width)),
        region=region,
        volatile=draw(st.booleans()),
        doc=draw(docs),
    )


@st.composite
def banks(draw: st.DrawFn, window: int, choices: list[str | None]) -> MappingProxyType[str, Register]:
    """Registers in windows 2 MiB above each other from `window` on, each of one of the regions `choices`."""
    found = []
    for index, name in enumerate(draw(st.lists(names, max_size=2, unique=True))):
        base = (window + draw(st.integers(0, 1))) << 21
        # the name is made unique among all owners, as names that are visible together must be
        found.append(draw(registers(f"{name}_{window}", base, index * 8, draw(st.sampled_from(choices)))))
    return frozen(found)


@st.composite
def memories(draw: st.DrawFn, window: int, choices: list[str | None]) -> MappingProxyType[str, Memory]:
    """Memories 2 MiB above each other, above all registers and decouplers, each of one of the regions `choices`."""
    found = []
    for index, name in enumerate(draw(st.lists(names, max_size=2, unique=True))):
        base = (1 << 50) + ((window + index) << 21)
        words = draw(st.integers(1, 64))
        dtype, form = draw(st.sampled_from([("uint32", (words,)), ("int16", (words, 2)), ("uint8", (2, words, 2))]))
        memory = Memory(
            name=f"{name}_{window}m",  # unique among all owners, and no stream's
            base_address=base,
            size=4 * words,
            offset=4 * draw(st.integers(0, 64)),
            access=draw(st.sampled_from([Access.RW, Access.RO, Access.WO])),
            dtype=dtype,
            shape=draw(maybe(st.just(form))),
            region=draw(st.sampled_from(choices)),
            doc=draw(docs),
        )
        found.append(memory)
    return frozen(found)


@st.composite
def regions(draw: st.DrawFn, name: str, index: int) -> Region:
    """A region; `index` keeps its decoupler and identity apart from those of others."""
    base = draw(addresses)
    frames = st.builds(
        lambda kind, row, first, more: FrameRange(kind, row, first, first + more),
        *(st.integers(0, limit) for limit in (7, 1023, 100, 100)),
    )
    return Region(
        name=name,
        loader=draw(st.sampled_from(LoaderKind)),
        loader_name=draw(maybe(names)),
        decoupler=draw(maybe(st.builds(Decoupler, st.just(base), st.just(0), st.just(index), st.just(32)))),
        footprint=tuple(draw(st.lists(frames, max_size=2))),
        identity=draw(maybe(st.builds(Identity, st.just(0x1000 * index), st.just(16)))),
        timeout=draw(maybe(st.floats(0.001, 3600))),
        allow_encrypted=draw(st.booleans()),
    )


@st.composite
def modules(draw: st.DrawFn, name: str, index: int, known: list[Region]) -> Module:
    """A module of one of the regions; `index` is its identity and keeps its registers apart."""
    region = draw(st.sampled_from(known))
    return Module(
        name=name,
        region=region.name,
        bitstream=draw(maybe(paths.map(Path))),
        sha256=draw(maybe(sums)),
        identity=draw(maybe(st.just(index))) if region.identity else None,
        model=draw(maybe(names)),
        registers=draw(banks(2 * index + 100, [None, region.name])),
        doc=draw(docs),
        memories=draw(memories(2 * index + 100, [None, region.name])),
    )


@st.composite
def streams(draw: st.DrawFn, name: str, known: list[str]) -> Stream:
    """A stream on the channel of its name."""
    return Stream(
        name=name,
        channel=name,
        direction=draw(st.sampled_from(Direction)),
        shape=draw(maybe(st.lists(st.integers(1, 5000), min_size=1, max_size=3).map(tuple))),
        dtype=draw(st.sampled_from(DTYPES)),
        slots=draw(st.integers(1, 64)),
        region=draw(maybe(st.sampled_from(known))) if known else None,
        cyclic=draw(st.booleans()),
        rate=draw(maybe(st.floats(0.1, 1e6))),
        limit=draw(maybe(st.floats(0.1, 1e6))),
        backpressure=draw(st.booleans()),
        stride=draw(maybe(st.integers(1, 1 << 20))),
        frame_id=draw(maybe(st.sampled_from(("base_link", "front/camera")))),
        camera_info=draw(maybe(cameras())),
        doc=draw(docs),
    )


@st.composite
def cameras(draw: st.DrawFn) -> CameraInfo:
    """A calibration."""
    numbers = st.integers(-(10**6), 10**6).map(lambda thousandths: thousandths / 1000)

    def matrix(length: int) -> tuple[float, ...]:
        return tuple(draw(st.lists(numbers, min_size=length, max_size=length)))

    return CameraInfo(
        width=draw(st.integers(1, 65535)),
        height=draw(st.integers(1, 65535)),
        k=matrix(9),
        distortion_model=draw(st.sampled_from(("plumb_bob", "rational_polynomial", "equidistant"))),
        d=draw(st.sampled_from((0, 4, 5, 8)).map(matrix)),
        r=matrix(9),
        p=draw(st.sampled_from((0, 12)).map(matrix)),
        name=draw(st.sampled_from(("", "front"))),
    )


@st.composite
def modes(draw: st.DrawFn, name: str, config: Config, index: int) -> Mode:
    """A mode of `config`: at most one module per region, registers of its own, streams changed here and there."""
    picked = draw(st.lists(st.sampled_from(list(config.modules.values())), unique_by=lambda module: module.region))
    merged = dict(config.streams)
    for stream in draw(st.lists(st.sampled_from(list(merged.values())), max_size=2)) if merged else []:
        shape = draw(st.lists(st.integers(1, 5000), min_size=1, max_size=3).map(tuple))
        merged[stream.name] = replace(stream, shape=shape, doc=draw(docs))
    return Mode(
        name=name,
        modules=tuple(module.name for module in picked),
        registers=draw(banks(2 * index + 1000, [None, *config.regions])),
        overlays=tuple(overlay for overlay in draw(overlays) if overlay not in config.overlays),
        streams=MappingProxyType(merged),
        doc=draw(docs),
        memories=draw(memories(2 * index + 1000, [None, *config.regions])),
    )


overlays = st.lists(
    st.builds(lambda name, file: Overlay(name, file and Path(file)), names, maybe(paths)),
    max_size=3,
    unique_by=lambda overlay: overlay.name,
)


@st.composite
def interrupts(draw: st.DrawFn, name: str, index: int, status: Register | None) -> Interrupt:
    """An interrupt on a line of its own."""
    if status is None:
        return Interrupt(name, base_address=0x1000 * index, doc=draw(docs))
    bit = draw(st.integers(0, status.width - 1))
    return Interrupt(name, uio=f"uio-{index}", status=status.name, bit=bit, acknowledge=draw(st.booleans()))


@st.composite
def configs(draw: st.DrawFn) -> Config:
    """A valid configuration."""
    kind = draw(st.sampled_from(ConfigType))
    full = kind is ConfigType.FULL
    all_regions = [
        draw(regions(n, i)) for i, n in enumerate(draw(st.lists(names, min_size=1, max_size=3, unique=True)))
    ]
    all_modules = [
        draw(modules(n, i, all_regions))
        for i, n in enumerate(draw(st.lists(names, min_size=1, max_size=4, unique=True)))
    ]
    known = [region.name for region in all_regions]
    own = draw(banks(10, [None, *known]))
    status = next(iter(own.values()), None)
    base = Config(
        name=draw(names),
        type=kind,
        device=draw(maybe(st.sampled_from(["xc7z020", "xczu7ev", "xck26"]))),
        bitstream=draw(maybe(paths.map(Path))) if full else None,
        sha256=draw(maybe(sums)) if full else None,
        loader=draw(st.sampled_from(_WHOLE)) if full else LoaderKind.FPGA_MANAGER,
        timeout=draw(maybe(st.floats(0.001, 3600))) if full else None,
        allow_encrypted=full and draw(st.booleans()),
        regions=frozen(all_regions),
        modules=frozen(all_modules),
        registers=own,
        overlays=(),
        streams=frozen([draw(streams(name, known)) for name in draw(st.lists(names, max_size=3, unique=True))]),
        interrupts=frozen(
            [draw(interrupts(n, i, status)) for i, n in enumerate(draw(st.lists(names, max_size=2, unique=True)))]
        ),
        clocks=frozen(draw(st.lists(st.builds(Clock, names, st.integers(1, 10**9), docs), max_size=2))),
        doc=draw(docs),
        memories=draw(memories(10, [None, *known])),
    )
    mode_names = draw(st.lists(names, min_size=1, max_size=4, unique=True))
    found = [draw(modes(name, base, index)) for index, name in enumerate(mode_names)]
    return replace(base, modes=frozen(found), default_mode=draw(maybe(st.sampled_from(mode_names))))
