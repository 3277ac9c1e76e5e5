# SPDX-License-Identifier: Apache-2.0
"""Plain values in normal form → `cm.schema.model.Config`.

The values have passed the JSON Schema; what is reported here is what a schema cannot express.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from cm.frozen import dataclass, field, replace
from cm.schema.model import (
    Access,
    BitField,
    Block,
    Clock,
    Config,
    ConfigType,
    Decoupler,
    Direction,
    FieldAccess,
    FrameRange,
    GpioLine,
    Identity,
    Interrupt,
    IsolationStep,
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
from cm.schema.pictures import camera_info, pixel_shape
from cm.schema.problems import KeyPath, did_you_mean, key_path

STATIC = "static"  # what `region:` says for the static part
IMPLIED_REGION = "prr0"
IMAGE_KEYS = ("bitstream", "sha256", "loader", "timeout", "allow_encrypted")  # of a full configuration


@dataclass(frozen=True, slots=True)
class Owner:
    """Where registers belong: the configuration, or one of its modules or modes."""

    path: KeyPath
    region: str | None  # for registers that name no region


@dataclass(slots=True)
class Context:
    """`report(path, code, message, hint)`; `where` has a register's path by its owner's path and its name.

    A memory's path is there too, by `memory_key`, since a memory and a register may have the same name.
    """

    report: Callable[[KeyPath, str, str, str], None]
    where: dict[tuple[KeyPath, str], KeyPath] = field(default_factory=dict)


def memory_key(owner: KeyPath, name: str) -> tuple[KeyPath, str]:
    """The key of a memory in `Context.where`."""
    return (*owner, "memories"), name


def build_registers(data: dict[str, Any], owner: Owner, context: Context) -> Mapping[str, Register]:
    """The registers of `data` (a configuration, module or mode), in windows and outside."""
    found: dict[str, Register] = {}
    for path, name, window, values in _listed_registers(data, owner.path):
        if name in found:
            first = key_path(context.where[owner.path, name])
            context.report(path, "duplicate_name", f"register {name} is here twice", f"the other one is {first}")
            continue
        register = _register(path, name, window, values, owner, context)
        if register is not None:
            found[name] = register
            context.where[owner.path, name] = path
    return MappingProxyType(found)


def _listed_registers(
    data: dict[str, Any], path: KeyPath
) -> Iterator[tuple[KeyPath, str, dict[str, Any], dict[str, Any]]]:
    for index, window in enumerate(data.get("mmio", ())):
        for name, values in window.get("registers", {}).items():
            yield (*path, "mmio", index, "registers", name), name, window, values
    for name, values in data.get("registers", {}).items():
        yield (*path, "registers", name), name, {}, values


def _register(
    path: KeyPath, name: str, window: dict[str, Any], values: dict[str, Any], owner: Owner, context: Context
) -> Register | None:
    base = values.get("base_address", window.get("base_address"))
    if base is None:
        context.report(path, "missing_key", "base_address is missing", "or put the register into a window under mmio")
        return None
    return Register(
        name=name,
        base_address=int(base),
        offset=int(values["offset"]),
        width=int(values.get("width", 32)),
        access=Access(values.get("access", "rw")),
        default=_integer(values.get("default")),
        reset=_integer(values.get("reset")),
        minimum=_integer(values.get("min")),
        maximum=_integer(values.get("max")),
        fields=bit_fields(values.get("fields", {}), (*path, "fields"), context),
        region=region_of(values, window, owner),
        volatile=values.get("volatile", False),
        doc=values.get("doc", ""),
        type=values.get("type", "uint"),
        fraction=int(values.get("fraction", 0)),
    )


def region_of(values: dict[str, Any], window: dict[str, Any], owner: Owner) -> str | None:
    """The region of what stands in a window: its own, else the window's, else its owner's; None: the static part."""
    name: str | None = values.get("region", window.get("region", owner.region))
    return None if name == STATIC else name


def _integer(value: float | None) -> int | None:
    """JSON Schema counts 1.0 as an integer; the model does not."""
    return None if value is None else int(value)


def bit_fields(data: dict[str, Any], path: KeyPath, context: Context) -> Mapping[str, BitField]:
    """The fields of a register."""
    found: dict[str, BitField] = {}
    for name, values in data.items():
        bits = _bits(values, (*path, name), context)
        if bits is not None:
            names = {word: int(value) for word, value in values.get("values", {}).items()}
            access = FieldAccess(values["access"]) if "access" in values else None
            found[name] = BitField(name, *bits, values.get("doc", ""), MappingProxyType(names), access)
    return MappingProxyType(found)


def _bits(values: dict[str, Any], path: KeyPath, context: Context) -> tuple[int, int] | None:
    """Lowest bit and width, from ``bits: "7:4"`` or from ``lsb`` and ``width``."""
    if ("bits" in values) == ("lsb" in values) or ("bits" in values and "width" in values):
        context.report(path, "missing_key", "where is the field?", "either bits, or lsb and width")
        return None
    if "lsb" in values:
        return int(values["lsb"]), int(values.get("width", 1))
    ends = [int(end) for end in str(values["bits"]).removesuffix(".0").split(":")]
    high, low = ends[0], ends[-1]
    if high < low:
        context.report((*path, "bits"), "bad_value", f"{high} is below {low}", f'highest bit first: "{low}:{high}"')
        return None
    return low, high - low + 1


def build_memories(data: dict[str, Any], owner: Owner, context: Context) -> Mapping[str, Memory]:
    """The memories of `data` (a configuration, module or mode), in windows and outside."""
    found: dict[str, Memory] = {}
    for path, name, window, values in _listed_memories(data, owner.path, context):
        key = memory_key(owner.path, name)
        if name in found:
            first = key_path(context.where[key])
            context.report(path, "duplicate_name", f"memory {name} is here twice", f"the other one is {first}")
            continue
        memory = _memory(path, name, window, values, owner, context)
        if memory is not None:
            found[name] = memory
            context.where[key] = path
    return MappingProxyType(found)


def _listed_memories(
    data: dict[str, Any], path: KeyPath, context: Context
) -> Iterator[tuple[KeyPath, str, dict[str, Any], dict[str, Any]]]:
    for index, window in enumerate(data.get("mmio", ())):
        here: KeyPath = (*path, "mmio", index)
        if "registers" not in window and "memories" not in window:
            context.report(here, "missing_key", "registers is missing", "registers or memories, or both")
        for name, values in window.get("memories", {}).items():
            yield (*here, "memories", name), name, window, values
    for name, values in data.get("memories", {}).items():
        yield (*path, "memories", name), name, {}, values


def _memory(
    path: KeyPath, name: str, window: dict[str, Any], values: dict[str, Any], owner: Owner, context: Context
) -> Memory | None:
    base = values.get("base_address", window.get("base_address"))
    if base is None:
        context.report(path, "missing_key", "base_address is missing", "or put the memory into a window under mmio")
        return None
    return Memory(
        name=name,
        base_address=int(base),
        size=int(values["size"]),
        offset=int(values.get("offset", 0)),
        access=Access(values.get("access", "rw")),
        dtype=values.get("dtype", "uint32"),
        shape=tuple(int(length) for length in values["shape"]) if "shape" in values else None,
        region=region_of(values, window, owner),
        doc=values.get("doc", ""),
    )


_DIRECTIONS = {"write": "mm2s", "tx": "mm2s", "read": "s2mm", "rx": "s2mm"}


def build_config(data: dict[str, Any], context: Context) -> Config:
    """The configuration of `data`, the value of the file's ``config``."""
    top: KeyPath = ("config",)
    kind = ConfigType(data.get("type", "partial"))
    regions = _regions(data, kind, context)
    through = only_region(regions)
    streams = _streams(data.get("streams", {}), {}, through, (*top, "streams"), context)
    modules = _modules(data.get("modules", {}), regions, context)
    modes = data.get("modes", {})
    if not modes and kind is ConfigType.FULL:
        modes = {"default": {}}
    return Config(
        name=data["name"],
        type=kind,
        device=data.get("device"),
        idcode=_integers({"v": data.get("idcode")})["v"],
        bitstream=_path(data.get("bitstream")),
        sha256=_lower(data.get("sha256")),
        loader=LoaderKind(data.get("loader", "fpga_manager")),
        timeout=_float(data.get("timeout")),
        allow_encrypted=data.get("allow_encrypted", False),
        default_mode=data.get("default_mode"),
        regions=MappingProxyType(regions),
        modules=modules,
        modes=MappingProxyType(
            {name: _mode(name, mode, modules, streams, through, context) for name, mode in modes.items()}
        ),
        registers=build_registers(data, Owner(top, None), context),
        overlays=_overlays(data),
        streams=streams,
        interrupts=MappingProxyType({name: _interrupt(name, v) for name, v in data.get("interrupts", {}).items()}),
        clocks=MappingProxyType({name: _clock(name, v) for name, v in data.get("clocks", {}).items()}),
        doc=data.get("doc", ""),
        memories=build_memories(data, Owner(top, None), context),
        blocks=MappingProxyType({name: _block(name, v) for name, v in data.get("blocks", {}).items()}),
        static=_static(data["static"]) if data.get("static") else None,
    )


def _static(values: dict[str, Any]) -> StaticIdentity:
    uid = values.get("uid")
    return StaticIdentity(**_integers({key: value for key, value in values.items() if key != "uid"}), uid=uid)


def only_region(regions: Iterable[str]) -> str | None:
    """The region that streams pass through where none is named: the one that there is."""
    names = list(regions)
    return names[0] if len(names) == 1 else None


def default_region(modules: Iterable[str], known: Mapping[str, Module]) -> str | None:
    """The region that registers of a mode belong to when none is named: that of its modules, if it is one."""
    regions = {known[name].region for name in modules if name in known}
    return regions.pop() if len(regions) == 1 else None


def _regions(data: dict[str, Any], kind: ConfigType, context: Context) -> dict[str, Region]:
    regions = {name: _region(name, values, context) for name, values in data.get("regions", {}).items()}
    if not regions and (kind is ConfigType.PARTIAL or data.get("modules")):
        return {IMPLIED_REGION: Region(IMPLIED_REGION)}
    return regions


_OF_REGISTERS = ("base_address", "offset", "bit", "width", "sequence")


def _decoupler(values: dict[str, Any], path: KeyPath, context: Context) -> Decoupler:
    _check_kind(values, path, context)
    own = _integers({key: value for key, value in values.items() if key not in ("sequence", "gpio")})
    line = _gpio_line(values["gpio"]) if "gpio" in values else None
    return Decoupler(**own, sequence=tuple(_isolation(step) for step in values.get("sequence", ())), gpio=line)


def _gpio_line(values: dict[str, Any]) -> GpioLine:
    line = values["line"]
    return GpioLine(values["chip"], line if isinstance(line, str) else int(line))


def _check_kind(values: dict[str, Any], path: KeyPath, context: Context) -> None:
    """Registers or a line: which keys there have to be depends on it."""
    if "gpio" in values:
        for key in sorted(values.keys() & set(_OF_REGISTERS)):
            message = f"{key} is of a register, and the decoupler is a GPIO line"
            context.report((*path, key), "value_range", message, "give registers or gpio, not both")
        return
    for key in ("base_address", "offset"):
        if key not in values:
            context.report(path, "missing_key", f"{key} is missing", "the register, or in place of it gpio")


def _isolation(values: dict[str, Any]) -> IsolationStep:
    numbers = _integers({key: value for key, value in values.items() if key != "timeout"})
    return IsolationStep(**numbers, timeout=float(values.get("timeout", 1)))


def _region(name: str, values: dict[str, Any], context: Context) -> Region:
    path: KeyPath = ("config", "regions", name)
    return Region(
        name=name,
        loader=LoaderKind(values.get("loader", "icap")),
        loader_name=values.get("loader_name"),
        decoupler=_decoupler(values["decoupler"], (*path, "decoupler"), context) if "decoupler" in values else None,
        footprint=tuple(_frames(_integers(frames)) for frames in values.get("footprint", ())),
        identity=Identity(**_integers(values["identity"])) if "identity" in values else None,
        timeout=_float(values.get("timeout")),
        allow_encrypted=values.get("allow_encrypted", False),
    )


def _frames(values: dict[str, Any]) -> FrameRange:
    first, last = (int(column) for column in values["columns"])
    return FrameRange(values.get("block_type", 0), values["row"], first, last)


def _modules(data: dict[str, Any], regions: Mapping[str, Region], context: Context) -> Mapping[str, Module]:
    found: dict[str, Module] = {}
    for name, values in data.items():
        path: KeyPath = ("config", "modules", name)
        region = values.get("region")
        if region is None:
            if len(regions) > 1:
                hint = f"there are several: {', '.join(regions)}"
                context.report(path, "missing_key", f"which region does module {name} fit? region is missing", hint)
                continue
            region = next(iter(regions))
        found[name] = Module(
            name=name,
            region=region,
            bitstream=_path(values.get("bitstream")),
            sha256=_lower(values.get("sha256")),
            identity=_integers({"v": values.get("identity")})["v"],
            model=values.get("model"),
            registers=build_registers(values, Owner(path, region), context),
            doc=values.get("doc", ""),
            memories=build_memories(values, Owner(path, region), context),
        )
    return MappingProxyType(found)


def _mode(
    name: str,
    values: dict[str, Any],
    modules: Mapping[str, Module],
    streams: Mapping[str, Stream],
    through: str | None,
    context: Context,
) -> Mode:
    path: KeyPath = ("config", "modes", name)
    named = tuple(values.get("modules", ()))
    own = _streams(values.get("streams", {}), streams, through, (*path, "streams"), context)
    owner = Owner(path, default_region(named, modules))
    return Mode(
        name=name,
        modules=named,
        registers=build_registers(values, owner, context),
        overlays=_overlays(values),
        streams=MappingProxyType({**streams, **own}) if own else streams,
        doc=values.get("doc", ""),
        memories=build_memories(values, owner, context),
        run=values.get("run"),
    )


def _overlays(data: dict[str, Any]) -> tuple[Overlay, ...]:
    return tuple(Overlay(values["name"], _path(values.get("file"))) for values in data.get("overlays", ()))


def _streams(
    data: dict[str, Any], base: Mapping[str, Stream], through: str | None, path: KeyPath, context: Context
) -> Mapping[str, Stream]:
    """The streams of `data`; keys left out are those of the stream of that name in `base`.

    `through` is the region of a stream that names none: where there is but one, its data can hardly pass it by.
    """
    found: dict[str, Stream] = {}
    for name, values in data.items():
        if name not in base and "direction" not in values:
            hint = did_you_mean(name, base) if base else "mm2s or s2mm"
            context.report((*path, name), "missing_key", f"direction of stream {name} is missing", hint)
            continue
        changes = _stream_values(values)
        start = base.get(name) or Stream(name, changes.get("channel", name), changes["direction"], region=through)
        found[name] = _of_pixels(replace(start, **changes), changes)
    return MappingProxyType(found)


def _of_pixels(stream: Stream, changes: dict[str, Any]) -> Stream:
    """The stream with the third axis that its format says, where that is said anew."""
    shape = stream.shape
    if shape is not None and "format" in changes and "shape" not in changes:
        shape = shape[:2]  # pixels of another size
    return replace(stream, shape=pixel_shape(shape, stream.format))


def _stream_values(values: dict[str, Any]) -> dict[str, Any]:
    changes = dict(values)
    if "direction" in changes:
        changes["direction"] = Direction(_DIRECTIONS.get(changes["direction"], changes["direction"]))
    if "shape" in changes:
        changes["shape"] = tuple(int(length) for length in changes["shape"])
    if changes.get("region") == STATIC:
        changes["region"] = None
    whole = ("slots", "stride", "slot_bytes", "max_length")
    for name, kind in (*((name, int) for name in whole), ("rate", float), ("limit", float)):
        if name in changes:
            changes[name] = kind(changes[name])
    if "camera_info" in changes:
        changes["camera_info"] = camera_info(changes["camera_info"])
    return changes


def _interrupt(name: str, values: dict[str, Any]) -> Interrupt:
    return Interrupt(name, **_integers(values))


def _block(name: str, values: dict[str, Any]) -> Block:
    given: dict[str, Any] = {key: tuple(v) if isinstance(v, list) else v for key, v in _integers(values).items()}
    return Block(name, **given)


def _clock(name: str, values: dict[str, Any]) -> Clock:
    return Clock(name, **{**values, "rate": int(values["rate"]), "tolerance": float(values.get("tolerance", 1))})


def _integers(values: dict[str, Any]) -> dict[str, Any]:
    """`values` with 1.0 as 1: JSON Schema takes both for an integer, the model does not."""
    return {key: int(value) if isinstance(value, float) else value for key, value in values.items()}


def _path(text: str | None) -> Path | None:
    return None if text is None else Path(text)


def _float(value: float | None) -> float | None:
    return None if value is None else float(value)


def _lower(text: str | None) -> str | None:
    return None if text is None else text.lower()
