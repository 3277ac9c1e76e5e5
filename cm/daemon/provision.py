# SPDX-License-Identifier: Apache-2.0
"""Configurations that arrive over the wire: a schema with its files, stored whole or not at all."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

from cm.errors import InvalidRequest
from cm.manager.resolve import checked_name
from cm.messages.requests import File
from cm.schema import load, loads
from cm.schema.model import Config

SCHEMA_FILE = "schema.yaml"
MAX_BYTES = 512 << 20


class Provisioner:
    """Keeps provisioned configurations below a folder, one subfolder each."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def stored(self) -> list[Path]:
        """The schema files of all configurations that were provisioned."""
        return sorted(self._folder.glob(f"*/{SCHEMA_FILE}"))

    def store(self, schema: str, files: tuple[File, ...]) -> Config:
        """Check the schema and put it with its files in place of what was there under its name.

        Raises SchemaError, InvalidRequest. The folder is written aside and renamed, so a killed
        manager leaves the old one or the new one.
        """
        config = loads(schema)
        names = [checked_name(f.name) for f in files]
        if len(set(names)) != len(names) or SCHEMA_FILE in names:
            raise InvalidRequest(f"files of {config.name!r}: names must differ, and none may be {SCHEMA_FILE!r}")
        if sum(len(f.data) for f in files) > MAX_BYTES:
            raise InvalidRequest(f"files of {config.name!r} have more than {MAX_BYTES >> 20} MiB together")
        self._folder.mkdir(parents=True, exist_ok=True)
        new = Path(tempfile.mkdtemp(prefix=f".{config.name}-", dir=self._folder))
        try:
            (new / SCHEMA_FILE).write_text(schema, encoding="utf-8")
            for file in files:
                (new / file.name).write_bytes(file.data)
            load(new / SCHEMA_FILE)
            self._swap(new, self._folder / config.name)
        except BaseException:
            shutil.rmtree(new, ignore_errors=True)
            raise
        return load(self._folder / config.name / SCHEMA_FILE)

    def _swap(self, new: Path, place: Path) -> None:
        old = place.with_name(f".{place.name}.old")
        shutil.rmtree(old, ignore_errors=True)
        if place.exists():
            place.rename(old)
        new.rename(place)
        shutil.rmtree(old, ignore_errors=True)

    def recover(self) -> None:
        """After a kill between the two renames: put the old configuration back; drop leftovers."""
        for old in self._folder.glob(".*.old") if self._folder.exists() else ():
            place = self._folder / old.name[1:].removesuffix(".old")
            if place.exists():
                shutil.rmtree(old, ignore_errors=True)
            else:
                old.rename(place)
        for half in self._folder.glob(".*-*") if self._folder.exists() else ():
            shutil.rmtree(half, ignore_errors=True)
