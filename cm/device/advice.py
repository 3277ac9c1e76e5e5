# SPDX-License-Identifier: Apache-2.0
"""What to do when a device does not open, for errors and for the survey."""

from __future__ import annotations

import errno
import grp
import stat
from collections.abc import Sequence
from pathlib import Path

from cm.device.paths import Root


def permission(path: Path) -> str:
    """Say who may open ``path``, and how the user can get that permission."""
    try:
        found = path.stat()
    except OSError:
        return "a folder above it may not be entered; run as root, or open that folder to your user"
    mode = stat.S_IMODE(found.st_mode)
    try:
        group = grp.getgrgid(found.st_gid).gr_name
    except KeyError:
        group = str(found.st_gid)
    if mode & stat.S_IWGRP and found.st_gid != 0:
        return f"it belongs to group {group} (mode {mode:04o}): add your user with 'usermod -aG {group} $USER'"
    return (
        f"it belongs to group {group} (mode {mode:04o}): give it to a group of yours with a udev rule (docs/device.md)"
    )


def missing(path: Path, present: Sequence[str]) -> str:
    """List what exists instead of ``path``."""
    if present:
        return f"there are: {', '.join(present)}"
    return f"{path.parent} holds no such device: is the driver's module loaded, and the node in the device tree?"


def unopened(error: OSError, root: Root, path: Path, present: Sequence[str]) -> str:
    """Return the advice for a device that did not open."""
    if error.errno == errno.ENOENT:
        return missing(path, present)
    if error.errno in (errno.EACCES, errno.EPERM):
        return permission(path)
    if error.errno == errno.EBUSY:
        return "one open file at a time may hold it: end the program that does (is the manager running?)"
    if error.errno in (errno.ENODEV, errno.ENXIO) and root.simulated:
        return f"start the simulated board: cm sim --root {root.path}"
    return ""


def names(folder: Path) -> list[str]:
    """Return the names in ``folder``, sorted; none if it cannot be listed."""
    try:
        return sorted(entry.name for entry in folder.iterdir() if not entry.name.startswith("."))
    except OSError:
        return []
