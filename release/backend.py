# SPDX-License-Identifier: Apache-2.0
"""The PEP 517 backend: setuptools, with two things that it does not do.

It asks for grpcio-tools only where there is no protobuf compiler, as distributions have one and no
grpcio-tools; and the archives are the same, byte for byte, wherever they are packed.
"""

from __future__ import annotations

import gzip
import os
import shutil
import tarfile
import zipfile
from pathlib import Path
from typing import Any

from setuptools import build_meta
from setuptools.build_meta import (
    build_editable,
    prepare_metadata_for_build_editable,
    prepare_metadata_for_build_wheel,
)

__all__ = [
    "build_editable",
    "build_sdist",
    "build_wheel",
    "get_requires_for_build_editable",
    "get_requires_for_build_sdist",
    "get_requires_for_build_wheel",
    "prepare_metadata_for_build_editable",
    "prepare_metadata_for_build_wheel",
]

PROTOC = "grpcio-tools>=1.48"
EPOCH = 1577836800  # 2020-01-01, where nobody says SOURCE_DATE_EPOCH; zip archives know no year before 1980
Settings = dict[str, Any] | None


def get_requires_for_build_wheel(config_settings: Settings = None) -> list[str]:
    """What setuptools asks for, and a protobuf compiler where this system has none."""
    return [*build_meta.get_requires_for_build_wheel(config_settings), *_compiler()]


def get_requires_for_build_editable(config_settings: Settings = None) -> list[str]:
    """As for a wheel."""
    return [*build_meta.get_requires_for_build_editable(config_settings), *_compiler()]


def get_requires_for_build_sdist(config_settings: Settings = None) -> list[str]:
    """The archive holds cm.proto as it is, so that nothing is compiled."""
    return list(build_meta.get_requires_for_build_sdist(config_settings))


def build_wheel(wheel_directory: str, config_settings: Settings = None, metadata_directory: str | None = None) -> str:
    """Write the wheel into `wheel_directory`; its file name."""
    name: str = build_meta.build_wheel(wheel_directory, config_settings, metadata_directory)
    plain_modes(Path(wheel_directory) / name)
    return name


def build_sdist(sdist_directory: str, config_settings: Settings = None) -> str:
    """Write the archive of the sources into `sdist_directory`; its file name."""
    name: str = build_meta.build_sdist(sdist_directory, config_settings)
    repack(Path(sdist_directory) / name, int(os.environ.get("SOURCE_DATE_EPOCH", EPOCH)))
    return name


def _compiler() -> list[str]:
    return [] if os.environ.get("PROTOC") or shutil.which("protoc") else [PROTOC]


def repack(archive: Path, time: int) -> None:
    """Write a .tar.gz anew: members by name, one time, no owner, modes 0644 and 0755."""
    new = archive.with_name(archive.name + ".new")
    with (
        tarfile.open(archive) as old,
        new.open("wb") as file,
        gzip.GzipFile("", "wb", 9, file, time) as packed,
        tarfile.open(fileobj=packed, mode="w", format=tarfile.PAX_FORMAT) as tar,
    ):
        for member in sorted(old.getmembers(), key=lambda member: member.name):
            tar.addfile(_plain(member, time), old.extractfile(member) if member.isreg() else None)
    new.replace(archive)


def _plain(member: tarfile.TarInfo, time: int) -> tarfile.TarInfo:
    plain = tarfile.TarInfo(member.name)
    plain.type, plain.size, plain.mtime = member.type, member.size, time
    plain.mode = 0o755 if member.isdir() or member.mode & 0o100 else 0o644
    return plain


def plain_modes(wheel: Path) -> None:
    """Write a wheel anew with modes 0644 and 0755, whatever umask it was built under."""
    new = wheel.with_name(wheel.name + ".new")
    with zipfile.ZipFile(wheel) as old, zipfile.ZipFile(new, "w", zipfile.ZIP_DEFLATED) as packed:
        for member in old.infolist():
            mode = 0o100755 if member.external_attr >> 16 & 0o100 else 0o100644
            plain = zipfile.ZipInfo(member.filename, member.date_time)
            plain.external_attr, plain.compress_type = mode << 16, zipfile.ZIP_DEFLATED
            packed.writestr(plain, old.read(member))
    new.replace(wheel)
