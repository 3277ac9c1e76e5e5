# SPDX-License-Identifier: Apache-2.0
"""Where to go: names in a request → a configuration and a mode of it → a goal; and the plan of steps there, as data.

`cm.manager.planning.planner` makes plans.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from cm.errors import InvalidRequest
from cm.manager.errors import NothingLoaded, UnknownConfig, UnknownMode
from cm.manager.state import steps as s
from cm.manager.state.record import Throughput
from cm.schema.model import Config, ConfigType
from cm.wire.messages.requests import ChangeMode
from cm.wire.messages.status import ClockStatus, PlanInfo, PlanStep


def target(request: ChangeMode, configs: Mapping[str, Config], loaded: str | None) -> tuple[Config, str]:
    """Where a request goes. Raises UnknownConfig, UnknownMode, NothingLoaded with what there is.

    That a word may also name a module is the convenience of the paper's plain text, and of nothing else.
    """
    if request.name_or_mode:
        return _word(request.name_or_mode, configs, loaded)
    if request.config_name:
        config = config_named(request.config_name, configs)
    elif loaded is not None:
        config = configs[loaded]
    else:
        raise NothingLoaded(f"nothing is loaded: name a configuration ({listed(configs)})")
    if not request.mode:
        return config, config.first_mode()
    if request.mode not in config.modes:
        alone = [
            f"; mode {m.name!r} has that module alone" for m in config.modes.values() if m.modules == (request.mode,)
        ]
        known = "".join(alone) or hint(request.mode, config.modes)
        raise UnknownMode(f"configuration {config.name!r} has no mode {request.mode!r}{known}")
    return config, request.mode


def config_named(name: str, configs: Mapping[str, Config]) -> Config:
    """A configuration by name."""
    config = configs.get(name)
    if config is None:
        raise UnknownConfig(f"no configuration {name!r}{hint(name, configs)}")
    return config


def mode_named(config: Config, name: str) -> str:
    """A mode by its name, or by the module that exactly one mode consists of."""
    if name in config.modes:
        return name
    alone = [mode.name for mode in config.modes.values() if mode.modules == (name,)]
    if len(alone) == 1:
        return alone[0]
    if len(alone) > 1:
        raise UnknownMode(f"module {name!r} alone makes several modes of {config.name!r}: {', '.join(alone)}; name one")
    raise UnknownMode(f"configuration {config.name!r} has no mode {name!r}{hint(name, config.modes)}")


def _word(word: str, configs: Mapping[str, Config], loaded: str | None) -> tuple[Config, str]:
    """One word in plain text: a mode or module of the loaded configuration, or else a configuration."""
    if loaded is not None:
        try:
            return configs[loaded], mode_named(configs[loaded], word)
        except UnknownMode:
            if word not in configs:
                raise
    if word in configs:
        return configs[word], configs[word].first_mode()
    raise NothingLoaded(f"nothing is loaded and {word!r} is not a configuration; there are {listed(configs)}")


def hint(name: str, known: Iterable[str]) -> str:
    """The nearest names, or all."""
    known = list(known)
    close = difflib.get_close_matches(name, known, n=2)
    return f"; did you mean {' or '.join(map(repr, close))}?" if close else f"; there are {listed(known)}"


def listed(names: Iterable[str]) -> str:
    """Names for a sentence."""
    return ", ".join(sorted(names)) or "none"


def checked_name(name: str) -> str:
    """A file name without folder parts. Raises InvalidRequest."""
    if not name or "/" in name or "\\" in name or name.startswith(".") or "\0" in name or len(name) > 200:
        raise InvalidRequest(f"file name {name!r}: a plain name without folders is expected, such as 'edge.bit'")
    return name


@dataclass(frozen=True, slots=True)
class Goal:
    """Where to go.

    `values` overrides registers' defaults: the way back restores what was written. `also` are modules
    beside the mode's, in regions that the mode leaves alone: the way back restores what they held.
    `static` is the full configuration whose image a partial one ran on, for the way back to it.
    `rates` are clocks' rates in Hz that the way back restores, whatever the configuration says of them; `found`
    likewise what registers held, by physical address and width, which no name of the configuration has to reach.
    `grounded`: the configuration's own overlays are on, by a plan before this one.
    """

    config: Config
    mode: str
    force: bool = False
    values: Mapping[str, int] = field(default_factory=lambda: MappingProxyType({}))
    also: tuple[str, ...] = ()
    static: Config | None = None
    rates: Mapping[str, int] = field(default_factory=lambda: MappingProxyType({}))
    found: Mapping[s.Place, int] = field(default_factory=lambda: MappingProxyType({}))
    grounded: bool = False

    @property
    def base(self) -> Config | None:
        """The configuration whose image has to be in the device; None if that cannot be known."""
        return self.config if self.config.type is ConfigType.FULL else self.static


@dataclass(frozen=True, slots=True)
class Plan:
    """Steps from one state to a goal.

    The devices of the static part may come with the configuration's own overlays: the port, clocks, register windows.
    Then `steps` end with those overlays, and `then` is what follows, as far as can be said beforehand: the plan that
    is carried out is made when the devices exist. `ports_later`: the port is among them, and cannot be asked now.
    """

    goal: Goal
    steps: tuple[s.Step, ...]
    full: bool = False
    then: tuple[s.Step, ...] = ()
    ports_later: bool = False

    @property
    def bytes(self) -> int:
        """Bytes that go through configuration ports."""
        return sum(map(image_bytes, (*self.steps, *self.then)))

    @property
    def regions(self) -> frozenset[str]:
        """The regions that the plan isolates, or that are isolated already."""
        return frozenset(step.region.name for step in (*self.steps, *self.then) if isinstance(step, s.Recouple))

    def info(self, throughput: Throughput) -> PlanInfo:
        """As it is shown."""
        rows = tuple(
            PlanStep(step.kind, step.subject, step.text, image_bytes(step), _seconds(step, throughput))
            for step in (*self.steps, *self.then)
        )
        seconds = sum(r.seconds for r in rows)
        clocks = tuple(ClockStatus(c.clock.name, c.clock.rate, c.achieved or 0) for c in self.clocks)
        return PlanInfo(self.goal.config.name, self.goal.mode, rows, self.bytes, seconds, clocks)

    @property
    def clocks(self) -> Iterator[s.SetClock]:
        """The clocks that are set."""
        return (step for step in (*self.steps, *self.then) if isinstance(step, s.SetClock))


def image_bytes(step: s.Step) -> int:
    """Bytes that a step sends through a configuration port."""
    return step.image.length if isinstance(step, s.Load | s.LoadStatic) else 0


def _seconds(step: s.Step, throughput: Throughput) -> float:
    beside = throughput.overhead(step.kind)
    if isinstance(step, s.Load | s.LoadStatic):
        return beside + throughput.seconds(step.port_kind, step.image.length)
    return beside
