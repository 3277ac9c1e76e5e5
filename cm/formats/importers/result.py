# SPDX-License-Identifier: Apache-2.0
"""The result of an import, and how it is written.

Names of other formats as names of the runtime schema.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TypeVar

from cm.errors import CmError
from cm.formats.bitstream import Report
from cm.formats.registers import LONGEST, UniqueNames, unaccented
from cm.frozen import dataclass, field, replace
from cm.hashes import sha256
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
_SHOWN = 40  # lines of a difference


class ImportRefused(CmError, ValueError):
    """A package from which no runtime schema can be made."""

    code = "import_refused"


@dataclass(frozen=True, slots=True)
class Imported:
    """Configurations with absolute paths, and what could not be carried over.

    `links`: names that must stand beside the schema and the files that they stand for; `files`: what was made for it.
    """

    configs: tuple[Config, ...]
    notes: tuple[str, ...]
    source: str  # the package's name, as a line in the schemas says it
    links: Mapping[str, Path] = field(default_factory=lambda: MappingProxyType({}))
    files: Mapping[str, bytes] = field(default_factory=lambda: MappingProxyType({}))


def frozen(items: Mapping[str, _T]) -> Mapping[str, _T]:
    """A read-only copy."""
    return MappingProxyType(dict(items))


def made(folder: Path) -> None:
    """Make a folder to write into if there is none. Raises ImportRefused for a file, OSError."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise ImportRefused(f"{folder} is a file, not a folder: one that does not exist yet is made") from None


def write(imported: Imported, folder: Path, force: bool = False) -> list[Path]:
    """Write ``<config>.yaml`` files and links into `folder`; return the files.

    Paths below the folder become relative, so that a package can be moved with its schemas. Each schema is read back
    before it is written, so that none is written that would be refused. A file that was edited since, or that is of
    another package, is replaced only with `force`. Raises ImportRefused, which shows the difference.
    """
    made(folder)
    texts: dict[Path, str] = {}
    for config in imported.configs:
        path = folder / f"{config.name}.yaml"
        if path in texts:
            raise ImportRefused(f"{path}: two configurations of the package would be this file; rename one of them")
        texts[path] = _signed(imported.source, dump(_relative(config, folder.resolve())))
    for path, text in texts.items():
        loads(text, path)
        if path.exists() and not force:
            _check_replaced(path, path.read_text(encoding="utf-8"), text)
    for path, text in texts.items():
        path.write_text(text, encoding="utf-8")
    for name, data in imported.files.items():
        (folder / name).write_bytes(data)
    for name, target in imported.links.items():
        _link(folder / name, target)
    return list(texts)


_HEAD = re.compile(r"# Made by cm import from (.+); below, unedited: ([0-9a-f]{16})\n")


def _signed(source: str, text: str) -> str:
    """The text of a schema below a line that says from what it was made, and whether it was edited since."""
    return f"# Made by cm import from {source}; below, unedited: {sha256(text.encode())[:16]}\n{text}"


def _check_replaced(path: Path, old: str, new: str) -> None:
    """Raise ImportRefused if a schema must not be replaced by another one."""
    before, after = _HEAD.match(old), _HEAD.match(new)
    assert after is not None
    if old == new:
        return
    if before is not None and before[1] == after[1] and sha256(old[before.end() :].encode())[:16] == before[2]:
        return
    why = "it was written or edited by hand"
    if before is not None and before[1] != after[1]:
        why = f"it is of {before[1]}, and {after[1]} would have the same name"
    lines = list(difflib.unified_diff(old.splitlines(), new.splitlines(), "there", "imported", lineterm="", n=1))
    shown = "\n".join(lines[:_SHOWN]) + (f"\n… and {len(lines) - _SHOWN} lines more" if len(lines) > _SHOWN else "")
    raise ImportRefused(f"{path}: {why}; --force replaces it, and --out writes elsewhere. The difference:\n{shown}")


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
