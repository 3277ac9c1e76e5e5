# SPDX-License-Identifier: Apache-2.0
"""Configurations that arrive over the wire: a schema with its files, stored whole or not at all."""

from __future__ import annotations

import hashlib
import logging
import os
from collections.abc import Callable
from pathlib import Path

from cm.errors import CmError, InvalidRequest
from cm.manager.planning.goals import checked_name
from cm.messages.requests import File
from cm.schema import load, loads
from cm.schema.model import Config

_LOG = logging.getLogger("cm")

SCHEMA_FILE = "schema.yaml"
_SIGNED_ONLY = "policy.signatures requires signed configurations; bring it by `cm import archive`"
MAX_BYTES = 512 << 20


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


class Provisioner:
    """Keeps provisioned configurations below a folder, one subfolder each."""

    def __init__(self, folder: Path, unsigned: bool = True) -> None:
        """`unsigned`: whether what nobody signed may be used; what comes over the wire is never signed."""
        self._folder = folder
        self._unsigned = unsigned

    def stored(self) -> list[Path]:
        """The schema files of all configurations that were provisioned."""
        return sorted(path for path in self._folder.glob(f"*/{SCHEMA_FILE}") if not path.parent.name.startswith("."))

    def configs(self) -> dict[str, Config]:
        """All configurations that were provisioned, by name; one that cannot be read is left out and logged."""
        found: dict[str, Config] = {}
        stored = self.stored()
        if stored and not self._unsigned:
            _LOG.error("%d provisioned configurations are left out: %s", len(stored), _SIGNED_ONLY)
            return found
        for path in stored:
            try:
                config = load(path)
            except CmError as error:
                _LOG.error("a provisioned configuration is left out: %s", error)
            else:
                found[config.name] = config
        return found

    def store(self, schema: str, files: tuple[File, ...], allowed: Callable[[str], None] = lambda _: None) -> Config:
        """Check the schema and put it with its files in place of what was there under its name.

        Raises SchemaError, InvalidRequest (also where only signed ones are taken), and what `allowed`
        raises for the configuration's name. The folder is written aside and renamed, so a killed manager
        leaves the old one or the new one.
        """
        if not self._unsigned:
            raise InvalidRequest(f"a configuration over the wire is refused: {_SIGNED_ONLY}")
        config = loads(schema)
        check_paths(config)
        allowed(config.name)
        names = [checked_name(f.name) for f in files]
        if len(set(names)) != len(names) or SCHEMA_FILE in names:
            raise InvalidRequest(f"files of {config.name!r}: names must differ, and none may be {SCHEMA_FILE!r}")
        for file in files:
            if file.sha256 and hashlib.sha256(file.data).hexdigest() != file.sha256.lower():
                raise InvalidRequest(f"cm_write_config: file {file.name!r} does not have the sha256 announced for it")
        if sum(len(f.data) for f in files) > MAX_BYTES:
            raise InvalidRequest(f"files of {config.name!r} have more than {MAX_BYTES >> 20} MiB together")
        self._folder.mkdir(parents=True, exist_ok=True)
        import tempfile  # with shutil 1 MiB, which most managers never need

        new = Path(tempfile.mkdtemp(prefix=f".{config.name}-", dir=self._folder))
        try:
            _write(new / SCHEMA_FILE, schema.encode())
            for file in files:
                _write(new / file.name, file.data)
            _sync(new)
            load(new / SCHEMA_FILE)
            self._swap(new, self._folder / config.name)
        except BaseException:
            _remove(new)
            raise
        return load(self._folder / config.name / SCHEMA_FILE)

    def _swap(self, new: Path, place: Path) -> None:
        old = place.with_name(f".{place.name}.old")
        _remove(old)
        if place.exists():
            place.rename(old)
        new.rename(place)
        _sync(self._folder)
        _remove(old)

    def recover(self) -> None:
        """After a kill between the two renames: put the old configuration back; drop leftovers."""
        for old in self._folder.glob(".*.old") if self._folder.exists() else ():
            place = self._folder / old.name[1:].removesuffix(".old")
            if place.exists():
                _remove(old)
            else:
                old.rename(place)
        for half in self._folder.glob(".*-*") if self._folder.exists() else ():
            _remove(half)


def _remove(folder: Path) -> None:
    import shutil

    shutil.rmtree(folder, ignore_errors=True)


def _write(path: Path, data: bytes | memoryview) -> None:
    """Written to the disk, not only to its cache: the renames that follow must not come before the content."""
    with path.open("wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())


def _sync(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
