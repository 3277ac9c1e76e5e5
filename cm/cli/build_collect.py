# SPDX-License-Identifier: Apache-2.0
"""``cm build collect``: pack a flow's results for the target."""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path

from cm.cli.common import add_json_option, answer, naming
from cm.design.collect.collected import Collected
from cm.design.collect.collection import collect, collect_ours, write
from cm.design.errors import BuildError
from cm.design.generate.generation import ANSWERS, load_design, output_folder
from cm.design.run.flow import Flow
from cm.design.runtime.answers import load_answers
from cm.frozen import replace


def fill_collect(parser: argparse.ArgumentParser) -> None:
    """Describe the action."""
    parser.description = (
        "Take .xsa, .hdf, .hwh, .bit and .bin files (or folders of them), check that they"
        " belong together, and write <config>/, ready for /lib/firmware/cm/, and "
        "<config>.tar.gz. With --schema, the files come from that build schema's flow; "
        "without it, from any flow."
    )
    parser.add_argument(
        "paths", nargs="*", type=Path, metavar="PATH", help="files or folders (default with --schema: its bitstreams/)"
    )
    parser.add_argument("--schema", type=Path, metavar="FILE", help="the build schema that the files were made from")
    parser.add_argument("--out", type=Path, metavar="DIR", help="the build schema's output folder")
    parser.add_argument("--name", help="name of the configuration (default: that of the design)")
    parser.add_argument("--target", "-o", type=Path, default=Path("target"), metavar="DIR", help="default: target/")
    parser.add_argument(
        "--sign",
        type=Path,
        action="append",
        default=[],
        metavar="KEY.pem",
        help="sign with this ed25519 key; may be repeated",
    )
    parser.add_argument(
        "--bundle-version",
        type=int,
        metavar="N",
        help="version of the signed files; higher is newer (default: the time)",
    )
    add_json_option(parser, run_collect)


def run_collect(args: argparse.Namespace) -> int:
    """Write the folder and the archive."""
    found = _ours(args) if args.schema else collect(args.paths, args.name)
    if args.sign:
        found = _signed(found, args.sign, args.bundle_version)
    args.target.mkdir(parents=True, exist_ok=True)
    with naming(args.target):
        folder, packed = write(found, args.target)
    config, files = found.config, sorted(found.files)
    counts = ((len(config.modules), "module"), (len(config.modes), "mode"), (len(found.files), "file"))
    contents = ", ".join(f"{count} {what}{'' if count == 1 else 's'}" for count, what in counts if count)
    lines = [f"{folder}: configuration {config.name}, {contents}", f"{packed}: the same as an archive"]
    lines += [f"note: {note}" for note in found.notes]
    lines.append(f"without a board: cm serve --sim --config {folder}")
    told = {"config": config.name, "folder": folder, "archive": packed, "files": files, "notes": found.notes}
    return answer(args, told, "\n".join(lines))


def _signed(found: Collected, keys: list[Path], version: int | None) -> Collected:
    """The same with a manifest of all files, and its signatures."""
    from cm.formats.signing import MANIFEST, SIGNATURES, add_manifest, sign

    number = int(os.environ.get("SOURCE_DATE_EPOCH") or time.time()) if version is None else version
    files = add_manifest(found.config.name, number, found.files)
    return replace(found, files={**files, SIGNATURES: sign(files[MANIFEST], keys)})


def _ours(args: argparse.Namespace) -> Collected:
    design = load_design(args.schema)
    out = output_folder(design.project, args.out)
    paths = args.paths or [_finished(out)]
    return collect_ours(paths, design.system, load_answers(out / ANSWERS), out)


def _finished(out: Path) -> Path:
    """The folder of bitstreams; BuildError where some may be of an earlier flow, with another static part."""
    left = [entry.step.name for entry in Flow(out).unfinished()]
    if left:
        raise BuildError(
            f"the flow in {out} is not finished, {', '.join(left)} must run: cm build run, or name the files to collect"
        )
    found = out / "bitstreams"
    if not found.is_dir():
        raise BuildError(f"{found} does not exist: cm build run makes it, or name the files to collect")
    return found
