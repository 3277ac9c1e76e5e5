# SPDX-License-Identifier: Apache-2.0
"""The versions of an imported configuration: the one in use, and earlier ones for a rollback.

``<out>/<config>/`` is in force. ``<out>/.<config>.<number>/`` are earlier ones, the highest number the latest. One
replaces the other by an exchange of names, in one step: if the process is killed before it, the old version is in
force, otherwise the new one.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import ClassVar

from cm.device.native.folder_exchange import exchange
from cm.errors import NotFound
from cm.formats.importers.result import ImportRefused, made
from cm.frozen import dataclass

KEEP = 3


class NoSuchVersion(NotFound):
    """There is no earlier version to go back to."""

    code: ClassVar[str] = "no_such_version"


@dataclass(frozen=True, slots=True)
class Version:
    """An earlier version in `folder`; a higher `number` is a later one."""

    number: int
    folder: Path


@contextlib.contextmanager
def locked(out: Path) -> Iterator[None]:
    """Allow one import or rollback below a folder at a time; remove what killed ones left behind."""
    made(out)
    descriptor = os.open(out, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        for left in out.glob(".import-*"):
            discard(left)
        yield
    finally:
        os.close(descriptor)


def versions(out: Path, config: str) -> list[Version]:
    """The earlier versions of a configuration, latest first."""
    pattern = re.compile(rf"\.{re.escape(config)}\.(\d+)")
    found = ((pattern.fullmatch(path.name), path) for path in out.iterdir()) if out.is_dir() else ()
    return sorted((Version(int(m[1]), path) for m, path in found if m), key=lambda v: v.number, reverse=True)


def put_in_force(new: Path, place: Path, keep: int) -> None:
    """Put a checked folder in force, after syncing it to disk; the last `keep` versions before it are kept."""
    new.chmod(0o755)
    sync(new)
    if place.exists():
        new.with_name(f".new-{new.stat().st_ino}").touch()
        _exchange(new, place)
        discard(new.parent)
    else:
        new.rename(place)
    sync(place.parent)
    for old in versions(place.parent, place.name)[keep:]:
        shutil.rmtree(old.folder, ignore_errors=True)


def discard(aside: Path) -> None:
    """Remove an import's folder; if it had exchanged its new version by then, what lies there is an earlier one."""
    for mark in aside.glob(".new-*"):
        for folder in aside.glob("[!.]*"):
            if mark.name != f".new-{folder.stat().st_ino}":
                before = versions(aside.parent, folder.name)
                folder.rename(aside.with_name(f".{folder.name}.{before[0].number + 1 if before else 1}"))
    shutil.rmtree(aside, ignore_errors=True)


def roll_back(place: Path, number: int | None = None) -> Version:
    """Put the latest earlier version, or the one with a number, in force; the one that was in force gets its number.

    Raises NoSuchVersion.
    """
    there = versions(place.parent, place.name)
    chosen = next((version for version in there if number in (None, version.number)), None)
    if chosen is None:
        known = ", ".join(str(version.number) for version in there)
        wanted = f"version {number}" if number is not None else "version"
        others = f" (there: {known})" if known else ""
        raise NoSuchVersion(f"no earlier {wanted} of configuration {place.name} in {place.parent}{others}")
    if place.exists():
        _exchange(chosen.folder, place)
    else:
        chosen.folder.rename(place)
    sync(place.parent)
    return chosen


def _exchange(one: Path, other: Path) -> None:
    try:
        exchange(str(one), str(other))
    except OSError as error:
        if error.errno in (errno.EINVAL, errno.ENOSYS):
            raise ImportRefused(
                f"{other}: the file system cannot exchange two folders in one step (renameat2), so nothing was changed"
            ) from error
        raise


def sync(folder: Path) -> None:
    """Sync the names in a folder to disk."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
