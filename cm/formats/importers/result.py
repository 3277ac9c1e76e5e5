# SPDX-License-Identifier: Apache-2.0
"""The result of an import, and how it is written.

Names of other formats as names of the runtime schema.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TypeVar

from cm.errors import CmError
from cm.formats.bitstream import Report
from cm.formats.registers import LONGEST, UniqueNames, unaccented
from cm.frozen import dataclass, field, replace
from cm.schema import dump, loads
from cm.schema.model import Config, Mode, Overlay, StaticIdentity


def to_name(text: str) -> str:
    """`text` without accents, with what a name cannot have replaced by ``_``; ``unnamed`` if nothing is left."""
    name = re.sub(r"[^A-Za-z0-9_-]+", "_", unaccented(text)).strip("_-")[:LONGEST].rstrip("_-") or "unnamed"
    return name if not name[0].isdigit() else f"_{name}"[:LONGEST]


class Names(UniqueNames):
    """Unique names of the schema, made from any text."""

    def take(self, name: str) -> str:
        """A name made from `name` that nothing has yet."""
        return super().take(to_name(name))


_T = TypeVar("_T")


class ImportRefused(CmError, ValueError):
    """A package from which no runtime schema can be made."""

    code = "import_refused"


@dataclass(frozen=True, slots=True)
class Imported:
    """Configurations with absolute paths, and what could not be carried over.

    `links`: names that must stand beside the schema and the files that they stand for.
    """

    configs: tuple[Config, ...]
    notes: tuple[str, ...]
    links: Mapping[str, Path] = field(default_factory=lambda: MappingProxyType({}))


def frozen(items: Mapping[str, _T]) -> Mapping[str, _T]:
    """A read-only copy."""
    return MappingProxyType(dict(items))


def made(folder: Path) -> None:
    """Make a folder to write into if there is none. Raises ImportRefused for a file, OSError."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise ImportRefused(f"{folder} is a file, not a folder: one that does not exist yet is made") from None


def write(imported: Imported, folder: Path) -> list[Path]:
    """Write ``<config>.yaml`` files and links into `folder`; return the files.

    Paths below the folder become relative, so that a package can be moved with its schemas. Each schema is read back
    before it is written, so that none is written that would be refused.
    """
    made(folder)
    texts = {folder / f"{config.name}.yaml": dump(_relative(config, folder.resolve())) for config in imported.configs}
    for path, text in texts.items():
        loads(text, path)
    for path, text in texts.items():
        path.write_text(text, encoding="utf-8")
    for name, target in imported.links.items():
        _link(folder / name, target)
    return list(texts)


def _link(path: Path, target: Path) -> None:
    if path.is_symlink():
        path.unlink()
    elif path.exists():
        raise ImportRefused(f"{path}: is in the way of a link to {target}; move it, or choose another folder")
    path.symlink_to(target)


def _place(path: Path | None, folder: Path) -> Path | None:
    return path.relative_to(folder) if path is not None and path.is_relative_to(folder) else path


def _overlays(overlays: tuple[Overlay, ...], folder: Path) -> tuple[Overlay, ...]:
    return tuple(replace(overlay, file=_place(overlay.file, folder)) for overlay in overlays)


def _relative(config: Config, folder: Path) -> Config:
    def mode(item: Mode) -> Mode:
        return replace(item, overlays=_overlays(item.overlays, folder))

    return replace(
        config,
        bitstream=_place(config.bitstream, folder),
        overlays=_overlays(config.overlays, folder),
        modules={
            name: replace(item, bitstream=_place(item.bitstream, folder)) for name, item in config.modules.items()
        },
        modes={name: mode(item) for name, item in config.modes.items()},
    )


def static_of(uid: str | None, report: Report | None = None) -> StaticIdentity | None:
    """The identity of a package's static design: its name, or the USERID of its image; None if there is neither."""
    user_id = report.user_id if report is not None else None
    return StaticIdentity(user_id=user_id, uid=uid or None) if uid or user_id is not None else None
