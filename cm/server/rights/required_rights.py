# SPDX-License-Identifier: Apache-2.0
"""What requests touch: from a request and the loaded configuration to needs. Pure."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from cm.frozen import dataclass, replace
from cm.schema.model import Config, ConfigType
from cm.server.rights.model import Need, Role
from cm.wire.messages import requests as rq

STATIC = "static"  # the part outside all regions
_READ_CONFIG, _WRITE_CONFIG = "cm_read_config", "cm_write_config"


@dataclass(frozen=True, slots=True)
class Scene:
    """What it takes to understand requests: the loaded configuration, its mode, and where a change would go.

    `target` finds the latter, and raises what the manager would raise: UnknownMode and the like.
    """

    loaded: Config | None
    mode: str | None
    target: Callable[[rq.ChangeMode], tuple[Config, str]]


def least(request: rq.Request) -> Need:
    """The lowest role that a request needs; admin for a kind of request that is not known here."""
    kind = _KINDS.get(type(request))
    return kind.least if kind else _UNKNOWN


def needs_of(request: rq.Request, scene: Scene) -> Iterator[Need]:
    """Everything that a request touches."""
    kind = _KINDS.get(type(request))
    yield from kind.parts(kind.least, request, scene) if kind and kind.parts else (least(request),)


def resolved(request: rq.Request, scene: Scene) -> rq.Request:
    """A change with configuration and mode by name, so that what is checked is what is done."""
    if isinstance(request, rq.ChangeMode):
        config, mode = scene.target(request)
        return replace(request, config_name=config.name, mode=mode, name_or_mode="")
    return request


def _named_config(base: Need, request: rq.ReadConfig | rq.PlanChange, scene: Scene) -> Iterator[Need]:
    yield replace(base, config=request.config_name or _loaded(scene))


def _cancel(base: Need, _: rq.CancelChange, __: Scene) -> Iterator[Need]:
    """The change that runs may be of any configuration."""
    yield replace(base, config="*")


def _change(base: Need, request: rq.ChangeMode, scene: Scene) -> Iterator[Need]:
    """A mode touches the regions of its modules; another configuration, or a full image, touches all regions."""
    config, mode = scene.target(request)
    loaded = scene.loaded
    regions = {config.modules[name].region for name in config.modes[mode].modules}
    if loaded is None or loaded.name != config.name or config.type is ConfigType.FULL or request.force:
        regions |= {STATIC, *config.regions, *(loaded.regions if loaded else ())}
    yield replace(base, config=config.name)
    if loaded is not None and loaded.name != config.name:
        yield replace(base, config=loaded.name)
    for region in regions:
        yield replace(base, config=config.name, region=region)


def _region(base: Need, request: rq.CheckRegion | rq.MapRegion, scene: Scene) -> Iterator[Need]:
    """Comparing takes the port for a while, and repairing writes to the region."""
    known = scene.loaded is not None and request.name in scene.loaded.regions
    yield replace(base, config=_loaded(scene), region=request.name if known else "*")


def _remove(base: Need, request: rq.RemoveConfig, _: Scene) -> Iterator[Need]:
    yield replace(base, config=request.config_name)


def _provision(base: Need, _: rq.Provision, __: Scene) -> Iterator[Need]:
    """Its name is known only when its schema has been read: `provisioning` is asked then."""
    yield base


def opening(name: str, writes: bool, scene: Scene) -> Need:
    """What it takes to open a stream or memory that is not copied; the topic is the name of the data socket."""
    return next(_data(Need(Role.OPERATE if writes else Role.OBSERVE, "data"), rq.ReadData(name), scene))


def mapping(name: str, scene: Scene) -> Need:
    """What it takes to map the registers of a module, a region or the static part: a right to all that are there."""
    loaded = scene.loaded
    module = loaded.modules.get(name) if loaded else None
    region = module.region if module else name
    known = loaded is not None and (region in loaded.regions or region == STATIC)
    return Need(Role.MAP, "data", _loaded(scene), region if known else "*", "*", "*")


def provisioning(name: str) -> Need:
    """The need to store or remove a configuration."""
    return Need(Role.PROVISION, _WRITE_CONFIG, name)


def _registers(base: Need, request: rq.ReadReg | rq.WriteReg, scene: Scene) -> Iterator[Need]:
    names = request.names if isinstance(request, rq.ReadReg) else [write.name for write in request.writes]
    config = _loaded(scene)
    if not names:
        yield replace(base, config=config, region="*", register="*")
    visible = scene.loaded.visible_registers(scene.mode) if scene.loaded else {}
    for name in names:
        register = visible.get(name.partition(".")[0])
        region = register.region or STATIC if register else "*"  # what does not exist takes rights to all
        yield replace(base, config=config, region=region, register=name)


def _data(base: Need, request: Any, scene: Scene) -> Iterator[Need]:
    name = request.name if isinstance(request, (rq.DescribeData, rq.DefineMemory)) else request.stream
    yield replace(base, config=_loaded(scene), region=_region_of(name, scene), data=name or "*")


def _region_of(name: str, scene: Scene) -> str:
    """The region of a stream or memory; all regions for one that does not exist, or was defined at run time."""
    if scene.loaded is None:
        return "*"
    mode = scene.loaded.modes.get(scene.mode or "")
    found = (mode.streams if mode else {}).get(name) or scene.loaded.streams.get(name)
    other = scene.loaded.visible_memories(mode.name if mode else None).get(name)
    if found is None and other is None:
        return "*"
    return (found.region if found else other.region if other else None) or STATIC


def _take(base: Need, request: rq.TakeLease, scene: Scene) -> Iterator[Need]:
    """A client that reserves something must be allowed to touch it."""
    kind, _, name = request.scope.partition(":")
    if kind == "region":
        yield replace(base, region=name)
    elif kind == "registers":
        yield from _registers(base, rq.ReadReg((name,)), scene)
    elif kind == "memories":
        yield replace(base, region=_region_of(name, scene), data=name)
    else:
        yield replace(base, config="*", region="*", register="*", data="*")


def _loaded(scene: Scene) -> str | None:
    return scene.loaded.name if scene.loaded else None


_Parts = Callable[[Need, Any, Scene], Iterator[Need]]
_UNKNOWN = Need(Role.ADMIN, "")


class _Kind:
    """A kind of request: the lowest role that it needs, and what it touches."""

    __slots__ = ("least", "parts")

    def __init__(self, role: Role, topic: str, parts: _Parts | None = None) -> None:
        self.least, self.parts = Need(role, topic), parts


_KINDS: dict[type, _Kind] = {
    rq.ReadStatus: _Kind(Role.OBSERVE, "cm_status"),
    rq.ReadConfig: _Kind(Role.OBSERVE, _READ_CONFIG, _named_config),
    rq.ListConfigs: _Kind(Role.OBSERVE, _READ_CONFIG),
    rq.PlanChange: _Kind(Role.OBSERVE, _READ_CONFIG, _named_config),
    rq.ChangeMode: _Kind(Role.OPERATE, _WRITE_CONFIG, _change),
    rq.CancelChange: _Kind(Role.OPERATE, _WRITE_CONFIG, _cancel),
    rq.Provision: _Kind(Role.PROVISION, _WRITE_CONFIG, _provision),
    rq.RemoveConfig: _Kind(Role.PROVISION, _WRITE_CONFIG, _remove),
    rq.ReadReg: _Kind(Role.OBSERVE, "cm_read_reg", _registers),
    rq.WriteReg: _Kind(Role.OPERATE, "cm_write_reg", _registers),
    rq.DescribeData: _Kind(Role.OBSERVE, "cm_data_config", _data),
    rq.ConfigureStream: _Kind(Role.OPERATE, "cm_data_config", _data),
    rq.DefineMemory: _Kind(Role.PROVISION, "cm_data_config", _data),
    rq.ReadData: _Kind(Role.OBSERVE, "cm_read_data", _data),
    rq.WriteData: _Kind(Role.OPERATE, "cm_write_data", _data),
    rq.Upload: _Kind(Role.OPERATE, "cm_upload"),
    rq.CheckRegion: _Kind(Role.OPERATE, "cm_region", _region),
    rq.MapRegion: _Kind(Role.OBSERVE, "cm_region", _region),
    rq.ReadIrq: _Kind(Role.OBSERVE, "cm_irq"),
    rq.TakeLease: _Kind(Role.OPERATE, "cm_lease", _take),
    rq.RenewLease: _Kind(Role.OPERATE, "cm_lease"),
    rq.BreakLease: _Kind(Role.ADMIN, "cm_lease"),
    rq.ReleaseLease: _Kind(Role.OPERATE, "cm_lease"),
}
