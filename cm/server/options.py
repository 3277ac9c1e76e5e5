# SPDX-License-Identifier: Apache-2.0
"""How a daemon is to serve, as data, and what of it is read again."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from cm.device import Root
from cm.frozen import dataclass, field
from cm.manager.manager import Settings
from cm.schema.model import Config
from cm.server.publisher import BYTES
from cm.server.rights.model import Access, Security
from cm.server.settings.model import USUAL, Limits, ScrubSettings


@dataclass(frozen=True, slots=True)
class Reloaded:
    """What was read: configurations by name, who may do what and use how much, and which changes need a restart."""

    configs: Mapping[str, Config]
    access: Access
    limits: Limits = USUAL
    notes: tuple[str, ...] = ()
    whole: bool = True  # whether every schema on the search path was valid


@dataclass(frozen=True, slots=True)
class Options:
    """How to serve. `load` is ``config`` or ``config/mode``, entered at start where nothing is loaded."""

    runtime_dir: Path
    state_dir: Path
    root: Root
    configs: Mapping[str, Config]
    listen: tuple[str, ...] = ()
    security: Security | None = None
    access: Access = Access()
    group: int | None = None  # of the runtime folder and its sockets; None: that of this process
    load: str = ""
    name: str = ""  # of the board, for people and to tell several apart; empty: that of its host
    queue_bytes: int = BYTES  # of frames that may wait for one subscriber over ZeroMQ
    assume_loaded: bool = False  # the PL holds a design, whatever the kernel knows of it
    example: bool = False  # `configs` are the shipped ones, which clients may replace
    unsigned: bool = True  # whether clients may provision configurations, which cannot be signed
    reload: Callable[[], Reloaded] | None = None  # reads schemas and settings again; None: there is nothing to read
    changed: Callable[[], object] | None = None  # a value that changes when settings or keys do; read every second
    settings: Settings = Settings()
    scrub: Mapping[str, ScrubSettings] = field(default_factory=dict)  # regions that are compared in the background
    limits: Limits = USUAL
