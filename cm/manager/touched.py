# SPDX-License-Identifier: Apache-2.0
"""Which configurations, regions, registers, streams and memories a request touches, as the board is now. Pure.

Whoever asks for a right to a request and whoever carries it out both find the place of a name here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, NamedTuple

from cm.frozen import dataclass, replace
from cm.schema.model import Config, ConfigType
from cm.wire.messages import requests as rq

if TYPE_CHECKING:
    from cm.wire.plane_packets import Open

STATIC = "static"  # the part outside all regions
ALL = "*"


class Thing(NamedTuple):
    """One thing that is touched: None where it is nothing of that kind, ALL where it may be anything of it."""

    config: str | None = None
    region: str | None = None
    register: str | None = None  # or register.field
    data: str | None = None  # a stream, or a memory


@dataclass(frozen=True, slots=True)
class Scene:
    """What it takes to understand requests: what is loaded, where a change would go, and which one runs or comes.

    `target` finds where it would go, and raises what the manager would raise: UnknownMode and the like.
    """

    loaded: Config | None
    mode: str | None
    target: Callable[[rq.ChangeMode], tuple[Config, str]]
    held: Mapping[str, str | None]  # the module of each region
    running: int = 0  # the number of the change that runs
    runs: tuple[Thing, ...] = ()  # what that touches
    coming: Config | None = None  # to which the change goes that was asked for last

    @property
    def config(self) -> str | None:
        """The name of the loaded one."""
        return self.loaded.name if self.loaded else None


def resolved(request: rq.Request, scene: Scene) -> rq.Request:
    """A change by its names, and the one to be cancelled by its number, so that what is checked is what is done."""
    if isinstance(request, rq.ChangeMode):
        config, mode = scene.target(request)
        return replace(request, config_name=config.name, mode=mode, name_or_mode="")
    if isinstance(request, rq.CancelChange):
        return rq.CancelChange(scene.running)
    return request


def window_place(config: Config, name: str) -> tuple[str, str] | None:
    """Region (or STATIC) and module whose registers a window of that name has; no module: whatever is there."""
    if name == STATIC or name in config.regions:
        return name, ""
    module = config.modules.get(name)
    if module is not None:
        return module.region, name
    return (STATIC, "") if name in config.blocks else None


def emptied(config: Config, unload: str) -> tuple[str, ...]:
    """The regions that `ChangeMode.unload` names."""
    return tuple(config.regions) if unload == rq.WHOLE else (unload,)


def nothing(_: object, __: Scene) -> Iterator[Thing]:
    """Nothing that has a name."""
    yield Thing()


def everything(_: object, __: Scene) -> Iterator[Thing]:
    """Whatever is loaded, now and later."""
    yield Thing(ALL, ALL, ALL, ALL)


def named_config(request: rq.ReadConfig | rq.PlanChange | rq.RemoveConfig, scene: Scene) -> Iterator[Thing]:
    """The configuration that is named, or the loaded one."""
    yield Thing(request.config_name or scene.config)


def change(request: rq.ChangeMode, scene: Scene) -> Iterator[Thing]:
    """A mode touches the regions of its modules; another configuration, a whole image or a way back all regions."""
    config, mode = scene.target(request)
    if request.unload:
        yield Thing(config.name)
        for name in (*emptied(config, request.unload), *((STATIC,) if request.unload == rq.WHOLE else ())):
            yield Thing(config.name, name)
        return
    others = [other for other in (scene.loaded, scene.coming) if other is not None and other.name != config.name]
    regions = {config.modules[name].region for name in config.modes[mode].modules}
    if others or scene.loaded is None or config.type is ConfigType.FULL or request.force or request.undo:
        regions |= {STATIC, *config.regions, *(region for other in others for region in other.regions)}
    for name in (config.name, *dict.fromkeys(other.name for other in others)):
        yield Thing(name)
    for name in regions:
        yield Thing(config.name, name)


def running_change(_: rq.CancelChange, scene: Scene) -> Iterator[Thing]:
    """What the change touches that runs."""
    yield from scene.runs or (Thing(scene.config),)


def region(request: rq.CheckRegion | rq.MapRegion, scene: Scene) -> Iterator[Thing]:
    """Comparing takes the port for a while, and repairing writes to the region."""
    known = scene.loaded is not None and request.name in scene.loaded.regions
    yield Thing(scene.config, request.name if known else ALL)


def registers(request: rq.ReadReg | rq.WriteReg, scene: Scene) -> Iterator[Thing]:
    """Each register that is named; all where none is."""
    names = request.names if isinstance(request, rq.ReadReg) else [write.name for write in request.writes]
    if not names:
        yield Thing(scene.config, ALL, ALL)
    visible = scene.loaded.visible_registers(scene.mode) if scene.loaded else {}
    for name in names:
        register = visible.get(name.partition(".")[0])
        place = register.region or STATIC if register else ALL  # what does not exist takes rights to all
        yield Thing(scene.config, place, name)


def data(request: rq.ReadData | rq.WriteData | rq.DescribeData | rq.ConfigureStream, scene: Scene) -> Iterator[Thing]:
    """The stream or memory that is named; all where none is."""
    yield _data(request.name if isinstance(request, rq.DescribeData) else request.stream, scene)


def defined_memory(request: rq.DefineMemory, scene: Scene) -> Iterator[Thing]:
    """It may lie in any region."""
    yield Thing(scene.config, ALL, data=request.name)


def opened_stream(wanted: Open, scene: Scene) -> Iterator[Thing]:
    """The stream that is named; all where none is."""
    yield _data(wanted.name, scene)


def opened_memory(_: Open, scene: Scene) -> Iterator[Thing]:
    """Memory of no stream: masters anywhere in the PL reach it."""
    yield Thing(scene.config, ALL, data=ALL)


def opened_window(wanted: Open, scene: Scene) -> Iterator[Thing]:
    """All registers and memories that are there."""
    place = window_place(scene.loaded, wanted.name) if scene.loaded else None
    yield Thing(scene.config, place[0] if place else ALL, ALL, ALL)


def lease(request: rq.TakeLease, scene: Scene) -> Iterator[Thing]:
    """A client that reserves something must be allowed to touch it."""
    kind, _, name = request.scope.partition(":")
    if kind == "region":
        yield Thing(region=name)
    elif kind == "registers":
        yield from registers(rq.ReadReg((name,)), scene)
    elif kind == "memories":
        yield _data(name, scene)._replace(config=None)
    else:
        yield Thing(ALL, ALL, ALL, ALL)


def _data(name: str, scene: Scene) -> Thing:
    """A stream or memory with its region; all regions for one that does not exist, or was defined at run time."""
    if scene.loaded is None:
        return Thing(None, ALL, data=name or ALL)
    streams = scene.loaded.streams_in(scene.mode, scene.held)
    found = streams.get(name) or scene.loaded.visible_memories(scene.mode).get(name)
    return Thing(scene.loaded.name, (found.region or STATIC) if found else ALL, data=name or ALL)
