# SPDX-License-Identifier: Apache-2.0
"""The manifest: which files a configuration's folder has, by sha256, and which version they are."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from pathlib import Path

from cm.formats.signing.errors import SignatureRefused
from cm.frozen import dataclass

MANIFEST = "manifest.json"
SIGNATURES = "manifest.sig"
_LARGEST = 1 << 20  # bytes of either: thousands of files
_SHA256 = re.compile(r"[0-9a-f]{64}")


@dataclass(frozen=True, slots=True)
class Manifest:
    """`files`: sha256 by name, of all files but the manifest and its signatures. A newer one has a higher `version`."""

    config: str
    version: int
    files: Mapping[str, str]


def add_manifest(config: str, version: int, files: Mapping[str, bytes]) -> dict[str, bytes]:
    """Return `files` with a manifest of them; the same input gives the same bytes."""
    plain = {name: data for name, data in files.items() if name not in (MANIFEST, SIGNATURES)}
    sums = {name: hashlib.sha256(data).hexdigest() for name, data in sorted(plain.items())}
    text = json.dumps({"config": config, "version": version, "files": sums}, indent=1) + "\n"
    return {**plain, MANIFEST: text.encode()}


def read_small(path: Path) -> bytes | None:
    """Return a file's bytes; None where there is none. Raises SignatureRefused for one that is too long."""
    try:
        with path.open("rb") as file:
            data = file.read(_LARGEST + 1)
    except FileNotFoundError:
        return None
    if len(data) > _LARGEST:
        raise SignatureRefused(f"{path}: over {_LARGEST} bytes")
    return data


def parse(data: bytes, path: Path) -> Manifest:
    """Return what a manifest says. Raises SignatureRefused for what is not a manifest."""
    try:
        found = json.loads(data)
        config, version, files = found["config"], found["version"], found["files"]
    except (ValueError, KeyError, TypeError, RecursionError):
        raise SignatureRefused(f"{path}: no manifest of a configuration") from None
    if not isinstance(config, str) or type(version) is not int or version < 0 or not isinstance(files, dict):
        raise SignatureRefused(f"{path}: config must be a name, version a number, files a map")
    for name, sha256 in files.items():
        if Path(name).name != name or not isinstance(sha256, str) or not _SHA256.fullmatch(sha256):
            raise SignatureRefused(f"{path}: {name!r} is not a plain file name with its sha256")
    return Manifest(config, version, files)


def check_files(folder: Path, manifest: Manifest) -> None:
    """Raise SignatureRefused unless the folder holds exactly the files of the manifest."""
    there = {path.name for path in folder.iterdir()} - {MANIFEST, SIGNATURES}
    missing, extra = sorted(manifest.files.keys() - there), sorted(there - manifest.files.keys())
    if missing or extra:
        what = f"{missing[0]} is missing" if missing else f"{extra[0]} was not signed"
        raise SignatureRefused(f"{folder}: {what}")
    for name, sha256 in manifest.files.items():
        if _sha256(folder / name) != sha256:
            raise SignatureRefused(f"{folder / name}: not the file that was signed (sha256)")


def _sha256(path: Path) -> str:
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()
