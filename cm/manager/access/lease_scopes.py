# SPDX-License-Identifier: Apache-2.0
"""What leases and requests are about: the names in their scopes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from difflib import get_close_matches

from cm.errors import NotFound
from cm.manager.access.leases import NAMED
from cm.schema.model import Config, Memory, Mode, Module
from cm.wire.messages.requests import ConfigureStream, Request, WriteData, WriteReg


def scopes_written(request: Request, config: Config | None, mode: str | None, memory: Memory | None) -> Iterator[str]:
    """What a request writes, in the terms of `leases_concerned`; `memory`: the memory that it names, if any."""
    if isinstance(request, WriteReg):
        visible = config.visible_registers(mode) if config else {}
        for name in {write.name.partition(".")[0] for write in request.writes}:
            yield f"registers:{name}"
            yield f"region:{visible[name].region if name in visible else None}"
    elif isinstance(request, (WriteData, ConfigureStream)):
        what = memory or (config.streams.get(request.stream) if config else None)
        yield f"memories:{request.stream}"
        yield f"region:{what.region if what else None}"


def check_scope_names_something(scope: str, configs: Iterable[Config], memories: Iterable[str]) -> None:
    """Raise NotFound if no served configuration has what a scope names: such a lease would keep no client off.

    `memories`: those that were defined at run time.
    """
    kind, _, name = scope.partition(":")
    if kind not in NAMED or not name:
        return
    known = set(memories) if kind == "memories" else set()
    for config in configs:
        known |= _named(kind, config)
    if name not in known:
        close = get_close_matches(name, known, 1)
        there = f"did you mean {close[0]!r}?" if close else f"there are {', '.join(sorted(known)) or 'none'}"
        raise NotFound(f"scope {scope!r}: no configuration has {name!r}; {there}")


def _named(kind: str, config: Config) -> set[str]:
    """The things of one kind that a configuration has, in any of its modes."""
    if kind == "region":
        return set(config.regions)
    views: list[Config | Mode | Module] = [config, *config.modes.values(), *config.modules.values()]
    return {name for view in views for name in (view.registers if kind == "registers" else view.memories)}
