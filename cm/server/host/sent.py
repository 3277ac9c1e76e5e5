# SPDX-License-Identifier: Apache-2.0
"""Checks of what clients send: names, paths, hashes, sizes, and the owner."""

from __future__ import annotations

import errno
import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from cm.errors import Busy, CmError, Forbidden, InvalidRequest
from cm.manager.planning.goals import checked_name
from cm.schema.model import Config
from cm.wire.messages.requests import File

SCHEMA_FILE = "schema.yaml"
MAX_BYTES = 512 << 20
CONFIGS_MAX = 256  # of all clients
SCHEMAS_EACH, SCHEMAS_ALL = 2 << 20, 4 << 20  # bytes of text of each, and of all: 10 to 15 times that in memory


class Reserved(InvalidRequest):
    """A configuration of the administrator has that name."""

    code = "config_reserved"


class NotTheirs(Forbidden):
    """A configuration that another client sent."""


class QuotaExceeded(Busy):
    """Clients' configurations may not use more space."""

    code = "quota"


class NoSpace(CmError):
    """The disk is full; nothing has changed."""

    code = "no_space"


@dataclass(frozen=True, slots=True)
class Sender:
    """Who sends or removes a configuration. `admin`: may do that to others' too."""

    account: str
    name: str
    admin: bool = False


OURSELVES = Sender("", "the manager", admin=True)


@dataclass(frozen=True, slots=True)
class Owned:
    """A configuration that was sent: its owner, its bytes, and how many of them are its schema."""

    account: str
    name: str
    bytes: int
    schema: int = 0


def check_paths(config: Config) -> None:
    """A schema that came over the wire names files that came with it, or the firmware folder's; no others.

    Raises InvalidRequest for an absolute path or one with '..'.
    """
    modes = (overlay for mode in config.modes.values() for overlay in mode.overlays)
    named: list[tuple[str, Path | None]] = [
        ("bitstream", config.bitstream),
        *((f"modules.{m.name}.bitstream", m.bitstream) for m in config.modules.values()),
        *((f"overlay {o.name}, file", o.file) for o in (*config.overlays, *modes)),
    ]
    for key, path in named:
        if path is not None and (path.is_absolute() or ".." in path.parts):
            raise InvalidRequest(
                f"configuration {config.name}: {key}: {path} leaves the configuration's folder; a schema that is "
                "sent names files that are sent with it, such as edge.bit"
            )


def check_files(config: str, files: tuple[File, ...]) -> None:
    names = [checked_name(f.name) for f in files]
    if len(set(names)) != len(names) or SCHEMA_FILE in names:
        raise InvalidRequest(f"files of {config!r}: names must differ, and none may be {SCHEMA_FILE!r}")
    for file in files:
        if file.sha256 and hashlib.sha256(file.data).hexdigest() != file.sha256.lower():
            raise InvalidRequest(f"cm_write_config: file {file.name!r} does not have the sha256 announced for it")
    if sum(len(f.data) for f in files) > MAX_BYTES:
        raise InvalidRequest(f"files of {config!r} have more than {MAX_BYTES >> 20} MiB together")


@contextmanager
def room_for(config: str) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT):
            raise
        raise NoSpace(f"configuration {config!r}: no room on the manager's disk; nothing has changed") from error
