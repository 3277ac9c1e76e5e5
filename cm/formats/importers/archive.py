# SPDX-License-Identifier: Apache-2.0
"""An archive of `cm build collect`: one configuration with its files, unpacked whole or not at all."""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Callable
from pathlib import Path, PurePosixPath
from typing import TypeAlias

from cm.formats.importers.config_versions import KEEP, discard, locked, put_in_force, roll_back, versions
from cm.formats.importers.result import ImportRefused
from cm.formats.tar import BadTar, Limits, Member, TarStream
from cm.frozen import dataclass
from cm.schema import SchemaError, load_folder
from cm.schema.model import Config
from cm.schema.named_files import FileMissing, bitstream_path, overlay_path

Judge: TypeAlias = "Callable[[Path, str, Path], object]"
LIMITS = Limits(total=1 << 30, members=4096)


@dataclass(frozen=True, slots=True)
class Unpacked:
    """A configuration that lies in `folder`, in `files`."""

    config: Config
    folder: Path
    files: tuple[str, ...]


def unpack(archive: Path, out: Path, keep: int = KEEP, judge: Judge | None = None) -> Unpacked:
    """Put an archive's configuration into ``out/<config>/``, in place of what was there under its name.

    The archive holds ``<config>/<file>…`` and nothing else. Schema, files and hashes are checked in another folder,
    which then takes its place in one step: a killed import leaves the old one or the new one. The last `keep` versions
    before it are kept for a rollback. `judge` is asked before a file is looked at, with the new folder, the
    configuration's name and the folder in force; what it raises is a refusal. Raises ImportRefused, SchemaError,
    FileMissing, OSError; `out` is then as before.
    """
    out = out.resolve()  # the files that a schema names are compared by their full paths
    with locked(out):
        aside = Path(tempfile.mkdtemp(prefix=".import-", dir=out))
        try:
            name, files = _extract(archive, aside)
            if judge is not None:  # before anything in it is read
                judge(aside / name, name, out / name)
            try:
                _checked(archive, aside / name)
            except (SchemaError, FileMissing) as error:  # the folder that they name is gone when they are read
                said = str(error).replace(f"{aside / name}/", "").replace(str(aside / name), "the archive")
                error.args = (f"{archive}: {said}",)
                raise
            put_in_force(aside / name, out / name, keep)
        finally:
            discard(aside)
        return Unpacked(_only(archive, out / name), out / name, files)


def back(place: Path, number: int | None = None) -> Unpacked:
    """Put an earlier version of the configuration at `place` in force, checked as an archive is.

    Raises NoSuchVersion, ImportRefused, SchemaError, FileMissing, OSError; what was in force then still is.
    """
    place = place.parent.resolve() / place.name
    with locked(place.parent):
        for version in versions(place.parent, place.name):
            if number in (None, version.number):
                _checked(version.folder, version.folder, place.name)
                break
        roll_back(place, number)
        files = tuple(sorted(path.name for path in place.iterdir()))
        return Unpacked(_only(place, place), place, files)


def _extract(archive: Path, folder: Path) -> tuple[str, tuple[str, ...]]:
    """Names and sizes are checked before a file's first byte is written; none of them is trusted."""
    names: list[str] = []
    top = ""
    try:
        with archive.open("rb") as file:
            tar = TarStream(file, LIMITS)
            for member in tar:
                parts = PurePosixPath(member.name).parts
                top = top or (parts[0] if parts else "")
                if member.is_folder and parts == (top,) and top not in ("/", ".", ".."):
                    continue
                _check_name(archive, member, parts, top)
                if parts[1] in names:
                    raise ImportRefused(f"{archive}: {member.name} is in it twice")
                names.append(parts[1])
                _write(tar, folder / top / parts[1])
    except BadTar as problem:
        raise ImportRefused(f"{archive}: no whole tar archive ({problem})") from problem
    if not names:
        raise ImportRefused(f"{archive}: no files; an archive of `cm build collect` holds <configuration>/<file>…")
    return top, tuple(sorted(names))


def _check_name(archive: Path, member: Member, parts: tuple[str, ...], top: str) -> None:
    if not member.is_file:
        raise ImportRefused(f"{archive}: {member.name} is not a plain file; links and devices are not unpacked")
    if len(parts) != 2 or ".." in parts or parts[0] in ("/", ".") or "\0" in member.name:
        raise ImportRefused(f"{archive}: {member.name!r} where <configuration>/<file> is expected")
    if parts[0] != top or top.startswith("."):
        raise ImportRefused(f"{archive}: files of {top!r} and {parts[0]!r}; one configuration is expected")


def _write(tar: TarStream, place: Path) -> None:
    place.parent.mkdir(exist_ok=True)
    with place.open("xb") as file:
        for piece in tar.blocks():
            file.write(piece)
        file.flush()
        os.fsync(file.fileno())


def _only(archive: Path, folder: Path, name: str = "") -> Config:
    configs, name = load_folder(folder), name or folder.name
    if list(configs) != [name]:
        found = " and ".join(configs) or "none"
        raise ImportRefused(f"{archive}: the schema of configuration {name!r} is expected; there is {found}")
    return configs[name]


def _checked(archive: Path, folder: Path, name: str = "") -> None:
    """Check that every file that the schema names is there, with the hash that it gives."""
    config = _only(archive, folder, name)
    wanted = [(bitstream_path(config, module, folder), module.sha256) for module in config.modules.values()]
    if config.bitstream is not None:
        wanted.append((bitstream_path(config, None, folder), config.sha256))
    overlays = [*config.overlays, *(overlay for mode in config.modes.values() for overlay in mode.overlays)]
    wanted += [(overlay_path(config, overlay, folder), None) for overlay in overlays]
    for path, sha256 in wanted:
        if path.parent != folder:
            raise ImportRefused(f"{archive}: the schema names {path}, which does not come with it")
        if sha256 is not None and _sha256(path) != sha256:
            raise ImportRefused(f"{archive}: {path.name} is not the file that the schema was made for (sha256)")


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        digest = hashlib.sha256()
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()
