# SPDX-License-Identifier: Apache-2.0
"""Names in a request → a configuration and a mode of it."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping

from cm.errors import InvalidRequest
from cm.manager.errors import NothingLoaded, UnknownConfig, UnknownMode
from cm.messages.requests import ChangeMode
from cm.schema.model import Config


def target(request: ChangeMode, configs: Mapping[str, Config], loaded: str | None) -> tuple[Config, str]:
    """Where a request goes. Raises UnknownConfig, UnknownMode, NothingLoaded with what there is."""
    if request.name_or_mode:
        return _word(request.name_or_mode, configs, loaded)
    if request.config_name:
        config = config_named(request.config_name, configs)
    elif loaded is not None:
        config = configs[loaded]
    else:
        raise NothingLoaded(f"nothing is loaded: name a configuration ({listed(configs)})")
    return config, mode_named(config, request.mode) if request.mode else config.first_mode()


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
    """One word in plain text: a mode or module of what is loaded, else a configuration."""
    if loaded is not None:
        try:
            return configs[loaded], mode_named(configs[loaded], word)
        except UnknownMode:
            if word not in configs:
                raise
    if word in configs:
        return configs[word], configs[word].first_mode()
    raise NothingLoaded(f"nothing is loaded and {word!r} is no configuration; there are {listed(configs)}")


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
