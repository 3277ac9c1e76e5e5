# SPDX-License-Identifier: Apache-2.0
"""Unpacks what another host made of a packed flow into the folder that it was packed from.

Nothing is written unless every file that the steps read is unchanged since it was packed, on both hosts. Stamps are
written last: if unpacking is interrupted, the steps still count as not run.
"""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from cm.design.errors import BuildError
from cm.design.run.pack import BACK, PACK, VERSION, digest
from cm.design.run.steps import Flow
from cm.formats.tar import BadTar, Limits, Member, TarStream

LIMITS = Limits(total=16 << 30, members=1 << 17, name=4096, seconds=7200.0)  # of what a host sends back
STAMPS = "stamps"


@dataclass(frozen=True, slots=True)
class Unpacked:
    """The steps that were run on the other host, those that were not, and how many files were written."""

    done: tuple[str, ...]
    left: tuple[str, ...]
    files: int


def unpack(source: Path, out: Path) -> Unpacked:
    """Copy the files of `source`, an archive or a folder, into `out`.

    Raises BuildError if it is not a packed flow, was packed from other files, or has names that lead elsewhere.
    """
    if source.is_dir():
        return _take(source, out)
    with tempfile.TemporaryDirectory(dir=out.parent, prefix=".cm-unpack-") as folder:
        _extract(source, Path(folder))
        return _take(Path(folder), out)


def _extract(archive: Path, folder: Path) -> None:
    """Extract the regular files of an archive into `folder`."""
    try:
        with archive.open("rb") as file:
            tar = TarStream(file, LIMITS)
            for member in tar:
                path = PurePosixPath(member.name)
                if path.is_absolute() or ".." in path.parts:
                    raise BuildError(f"{archive}: {member.name} leads out of the archive")
                if member.is_file:
                    _extract_file(tar, member, folder / path)
    except (OSError, BadTar) as error:
        raise BuildError(f"{archive} cannot be read: {error}") from None


def _extract_file(tar: TarStream, member: Member, target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    with target.open("wb") as file:
        for piece in tar.blocks():
            file.write(piece)
    os.utime(target, (member.mtime, member.mtime))


def _take(folder: Path, out: Path) -> Unpacked:
    base, told = _find(folder)
    flow = Flow(out)
    _check_here(out, told)
    done, left = _check_there(base, flow, told)
    count = 0
    for path in _files(base, flow, done):
        target = out / path.relative_to(base)
        target.parent.mkdir(parents=True, exist_ok=True)
        new = target.with_name(f"{target.name}.new")
        shutil.copy2(path, new)
        if path.parent.name == STAMPS:  # in the steps' order, so that none is older than an earlier one's
            new.touch()
        new.replace(target)
        count += 1
    return Unpacked(tuple(done), tuple(left), count)


def _find(folder: Path) -> tuple[Path, dict[str, Any]]:
    """Find the output folder in what came back, and the description of what was packed."""
    found = sorted(folder.rglob(PACK), key=lambda path: len(path.parts))
    if not found:
        raise BuildError(f"{folder} holds no {PACK}: it is not a flow that cm build pack has packed")
    try:
        told = json.loads(found[0].read_text(encoding="utf-8"))
        if told["version"] != VERSION or not all(isinstance(told[key], kind) for key, kind in _KEYS.items()):
            raise ValueError(f"version {told['version']}")
    except (ValueError, KeyError, TypeError) as error:
        raise BuildError(f"{found[0]} was not written by cm build pack: {error}") from None
    return found[0].parent, told


_KEYS = {"project": str, "steps": list, "files": dict}


def _check_here(out: Path, told: dict[str, Any]) -> None:
    """Check that every file on this host is unchanged since it was packed."""
    changed = [name for name, known in told["files"].items() if digest(out / name) != known]
    if changed:
        few = ", ".join(sorted(changed)[:5]) + (f" and {len(changed) - 5} more" if len(changed) > 5 else "")
        raise BuildError(
            f"{few}: not what was packed any more; what came back is of other files: pack and run it again"
        )


def _check_there(base: Path, flow: Flow, told: dict[str, Any]) -> tuple[list[str], list[str]]:
    """Return the steps that the other host ran, on the files that were packed, and those that it did not."""
    known = {step.name: step for step in flow.steps}
    done, left = [], []
    for name in told["steps"]:
        if name not in known:
            raise BuildError(f"the flow has no step {name} any more: generate, pack and run it again")
        stamp = base / STAMPS / f"{name}.done"
        if not stamp.is_file():
            left.append(name)
            continue
        if stamp.read_text(encoding="utf-8") != flow.checksums(known[name]):
            raise BuildError(f"step {name} was run there with other files than were packed ({stamp.name} says so)")
        lost = [output for output in known[name].outputs if not (base / output).is_file()]
        if lost:
            raise BuildError(f"step {name} is done, but {', '.join(lost)} did not come back")
        done.append(name)
    return done, left


def _files(base: Path, flow: Flow, done: list[str]) -> Iterator[Path]:
    """Logs and reports, outputs of the steps that are done, and their stamps last."""
    outputs = {output for step in flow.steps if step.name in done for output in step.outputs}
    for name in (name for name in BACK if name != STAMPS):
        for path in sorted((base / name).rglob("*")):
            plain = path.is_file() and not path.is_symlink()
            kept = name in ("logs", "reports") or path.relative_to(base).as_posix() in outputs
            more = name == "bitstreams" and path.suffix in (".hwh", ".xsa")
            if plain and (kept or more):
                yield path
    for step in flow.steps:
        if step.name in done:
            for kind in ("inputs", "done"):
                path = base / STAMPS / f"{step.name}.{kind}"
                if path.is_file():
                    yield path
