# SPDX-License-Identifier: Apache-2.0
"""Packs a flow into an archive for another host, and unpacks what that host made of it.

The archive has the generated files, everything that their steps read, and the outputs of steps so far, all at their
places relative to the output folder: no path in it is absolute. ``pack.json`` has the checksum of every file that
steps read. Results are accepted only if none of these files has changed since, on either host: nothing is written
otherwise. Stamps are written last: if unpacking is interrupted, the steps still count as not run.
"""

from __future__ import annotations

import gzip
import io
import json
import os
import shutil
import tarfile
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, BinaryIO

from cm.design.errors import BuildError
from cm.design.plan.steps import Step, ends, steps_json
from cm.design.render import Renderer
from cm.design.run.flow import Flow, State, digest
from cm.formats.tar import BadTar, Limits, Member, TarStream

PACK = "pack.json"
VERSION = 1
BACK = ("stamps", "logs", "reports", "checkpoints", "bitstreams")  # what a host sends back


@dataclass(frozen=True, slots=True)
class Packed:
    """The steps in an archive, and the number of files."""

    path: Path
    steps: tuple[str, ...]
    files: int


def pack(out: Path, name: str, folders: Iterable[Path], archive: Path, modules: Sequence[str] = ()) -> Packed:
    """Write the flow below `out` to `archive` (.tar.gz); `folders`: those that steps read as a whole.

    With `modules`, only their synthesis and the step in their region's abstract shell: nothing of the static design
    is included. Raises BuildError if a file that a step reads is missing, or a shell has not been made yet.
    """
    flow = Flow(out)
    steps = _module_steps(flow, modules) if modules else flow.steps
    read = _inputs(out, steps)
    content = _told(name, steps, read) | (_of_modules(out, name, steps) if modules else {})
    files = {Path(os.path.normpath(out / path)) for path in read}
    files |= {*_kept(flow, steps, bool(modules)), *_below(folders)}
    files -= {out / path for path in content}
    root = Path(os.path.commonpath([out, *files]))
    entries: dict[str, Path | bytes] = {f"{name}/{path.relative_to(root).as_posix()}": path for path in files}
    entries |= {f"{name}/{(out / path).relative_to(root).as_posix()}": data for path, data in content.items()}
    archive.parent.mkdir(parents=True, exist_ok=True)
    with archive.open("wb") as raw:
        write_tar(raw, entries, 6)  # checkpoints of gigabytes
    return Packed(archive, tuple(step.name for step in steps), len(entries))


def _module_steps(flow: Flow, modules: Sequence[str]) -> tuple[Step, ...]:
    """The synthesis of modules, and their steps in shells, which must exist."""
    ends = flow.ends_of(modules)
    wrong = [name for name in ends if not name.startswith("module_")]
    if wrong:
        hint = "write static: {abstract_shells: true}, and leave the module out of the first run"
        raise BuildError(f"{', '.join(wrong)} opens the whole static design: {hint}")
    states = {entry.step.name: entry.state for entry in flow.plan(modules)}
    by_name = {step.name: step for step in flow.steps}
    found: list[Step] = []
    for end in ends:
        shell = next(name for name in by_name[end].after if name.startswith("shell_"))
        if states[shell] is not State.DONE:
            raise BuildError(f"the abstract shell that {end} needs is not made yet: cm build run, then pack it again")
        before = tuple(name for name in by_name[end].after if name.startswith("synth_"))
        found += [by_name[name] for name in before]
        found.append(Step(end, by_name[end].title, before, by_name[end].outputs))
    return tuple(dict.fromkeys(found))


def _inputs(out: Path, steps: Sequence[Step]) -> dict[str, str]:
    """The files that steps read, relative to `out`, with checksums."""
    found: dict[str, str] = {}
    for step in steps:
        for name in (out / f"inputs/{step.name}.list").read_text(encoding="utf-8").splitlines():
            found[name] = digest(out / name)
        for name in _shells(out, step):
            found[name] = digest(out / name)
    missing = [name for name, known in found.items() if not known]
    if missing:
        raise BuildError(f"steps read what is not there: {', '.join(missing)}")
    return found


def _shells(out: Path, step: Step) -> Iterator[str]:
    """The abstract shell that a step opens, if it is not made by a step in the archive."""
    if not step.name.startswith("module_") or any(name.startswith("shell_") for name in step.after):
        return
    script = (out / f"tcl/step_{step.name}.tcl").read_text(encoding="utf-8")
    shell = next(word for word in script.split() if word.startswith("checkpoints/shell_"))
    yield from (shell, str(PurePosixPath(shell).with_suffix(".id")))


def _told(name: str, steps: Sequence[Step], read: dict[str, str]) -> dict[str, bytes]:
    """The description of the archive, with checksums."""
    told = {"version": VERSION, "project": name, "steps": [step.name for step in steps], "files": read}
    return {PACK: (json.dumps(told, indent=2, sort_keys=True) + "\n").encode()}


def _of_modules(out: Path, name: str, steps: Sequence[Step]) -> dict[str, bytes]:
    """The files of a flow of these modules only, in place of the whole one."""
    banner = f"Generated by cm build for {name}."
    make = Renderer(out.parent, out, banner).render("Makefile.j2", {"steps": steps, "last": ends(steps)})
    return {"Makefile": make.encode(), "steps.json": f"{steps_json(steps)}\n".encode()}


def _kept(flow: Flow, steps: Sequence[Step], modules: bool) -> Iterator[Path]:
    """The lists of the steps' inputs, and the outputs of steps so far (none for modules alone)."""
    out = flow.folder
    yield from (out / f"inputs/{step.name}.list" for step in steps)
    if not modules:
        yield from (out / name for name in ("Makefile", "steps.json"))
        yield from _below(out / name for name in (*BACK, "work"))


def _below(folders: Iterable[Path]) -> Iterator[Path]:
    for folder in folders:
        yield from (path for path in sorted(folder.rglob("*")) if path.is_file())


def write_tar(raw: BinaryIO, entries: Mapping[str, Path | bytes], level: int = 9) -> None:
    """Write a .tar.gz of files and bytes by name, without owners; the same files and times give the same bytes."""
    with gzip.GzipFile("", "wb", level, raw, 0) as zipped, tarfile.open(None, "w", zipped) as tar:
        for name, data in sorted(entries.items()):
            info = tarfile.TarInfo(name)
            info.mode = 0o644
            if isinstance(data, bytes):
                info.size = len(data)
                tar.addfile(info, io.BytesIO(data))
                continue
            about = data.stat()
            info.size, info.mtime = about.st_size, int(about.st_mtime)
            with data.open("rb") as file:
                tar.addfile(info, file)


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
