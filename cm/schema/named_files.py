# SPDX-License-Identifier: Apache-2.0
"""Finds the files that a configuration names: bitstreams and overlays.

A file is looked for beside the schema file, then in ``lib/firmware/cm/<config>/`` and
``lib/firmware/`` under the root; an absolute path is taken as it is.
"""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterable
from pathlib import Path
from typing import ClassVar

from cm.errors import NotFound
from cm.schema.model import Config, ConfigType, Module, Overlay
from cm.schema.problems import did_you_mean

_ABSENT = (errno.ENOENT, errno.ENOTDIR, errno.ELOOP, errno.EACCES, errno.EPERM)  # in a folder that we may not read, too
BITSTREAM_SUFFIXES = (".bit", ".bin", ".bit.bin")


class FileMissing(NotFound):
    """A file that a configuration needs does not exist; the sentence lists the places that were searched."""

    code: ClassVar[str] = "file_missing"


def find_file(config: Config, candidates: Iterable[str | Path], root: Path | str = "/", whose: str = "") -> Path:
    """The first of `candidates` that is a file; every folder is searched for all of them in order.

    Raises `FileMissing` with the folders that were searched, and `whose` file it is.
    """
    names = list(candidates)
    folders = _folders(config, root)
    for folder in folders:
        for name in names:
            place = os.path.join(folder, name)  # noqa: PTH118 (a Path for each takes ten times as long)
            if _is_file(place):
                return Path(place)
    relative = not all(Path(name).is_absolute() for name in names)
    first, *others = [str(name) for name in names]
    named = first + (f" (or {', '.join(others)})" if others else "")
    looked = f": put it into {folders[0]}; also searched: {', '.join(folders[1:])}" if relative else ""
    raise FileMissing(f"configuration {config.name}: {f'{whose}: ' if whose else ''}no file {named}{looked}")


def _is_file(place: str) -> bool:
    try:
        return stat.S_ISREG(os.stat(place).st_mode)  # noqa: PTH116
    except OSError as error:
        if error.errno in _ABSENT:
            return False
        raise
    except ValueError:  # a NUL in its name
        return False


def bitstream_path(config: Config, module: Module | str | None, root: Path | str = "/") -> Path:
    """The bitstream of `module`, or (None) of the whole configuration.

    Raises `FileMissing`, or `NotFound` for a name that is not a module.
    """
    if module is None:
        return find_file(config, _candidates(config.name, config.bitstream), root, "the whole device (key bitstream)")
    if isinstance(module, str):
        module = _module(config, module)
    whose = f"module {module.name} of region {module.region} (key bitstream)"
    return find_file(config, _candidates(module.name, module.bitstream), root, whose)


def overlay_path(config: Config, overlay: Overlay | str, root: Path | str = "/") -> Path:
    """The compiled overlay (.dtbo) of `overlay`; raises `FileMissing`."""
    if isinstance(overlay, str):
        overlay = Overlay(overlay)
    return find_file(config, [overlay.file or f"{overlay.name}.dtbo"], root, f"overlay {overlay.name} (key file)")


def firmware_spellings(name: str) -> list[str]:
    """Packages of dfx-mgr may name x.bit.bin where the folder holds x.bin, and the other way round."""
    stem = os.path.basename(name).removesuffix(".bin").removesuffix(".bit")  # noqa: PTH119
    return [f"{stem}{suffix}" for suffix in (".bit.bin", ".bin", ".bit")]


def named_files(config: Config) -> list[str]:
    """Every name that a file of `config` may have, below the folders that are searched for it."""
    found = _candidates(config.name, config.bitstream) if config.type is ConfigType.FULL else []
    for module in config.modules.values():
        found += [*_candidates(module.name, module.bitstream), f"{module.name}.dtbo"]
    overlays = [*config.overlays, *(overlay for mode in config.modes.values() for overlay in mode.overlays)]
    found += [overlay.file or f"{overlay.name}.dtbo" for overlay in overlays]
    return list(dict.fromkeys(map(str, found)))


def _candidates(name: str, written: Path | None) -> list[str | Path]:
    return [written] if written is not None else [name + suffix for suffix in BITSTREAM_SUFFIXES]


def _module(config: Config, name: str) -> Module:
    if name not in config.modules:
        hint = did_you_mean(name, config.modules)
        raise NotFound(f"configuration {config.name} has no module {name} ({hint})")
    return config.modules[name]


def _folders(config: Config, root: Path | str) -> list[str]:
    beside = [] if config.source is None else [os.path.dirname(config.source)]  # noqa: PTH120
    firmware = os.path.join(root, "lib/firmware")  # noqa: PTH118
    return [*beside, f"{firmware}/cm/{config.name}", firmware]
