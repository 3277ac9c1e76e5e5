# SPDX-License-Identifier: Apache-2.0
"""``cm import dfx-mgr|pynq|archive``: runtime schemas from other managers' packages, and our own archives."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cm.cli.common import add_json_option, answer, naming, print_json
from cm.errors import CmError
from cm.extras import installing
from cm.formats.importers import Imported, import_dfx_mgr, import_pynq, unpack, write
from cm.schema import dump
from cm.server.settings.model import Settings

if TYPE_CHECKING:
    from cm.formats.importers.archive import Unpacked
    from cm.formats.signing import Judgement

FIRMWARE = Path("/lib/firmware/cm")  # where the manager looks for a configuration's files


def fill_parser(parser: argparse.ArgumentParser) -> None:
    """Describe the command."""
    parser.description = (
        "Make runtime schemas that load another manager's package in place, and report "
        "what could not be carried over; or unpack an archive of `cm build collect`."
    )
    formats = parser.add_subparsers(dest="format", metavar="FORMAT", required=True)
    dfx = formats.add_parser(
        "dfx-mgr",
        help="make schemas of a base folder of dfx-mgr, the one with shell.json, or of an image with its .dtbo",
    )
    dfx.add_argument("source", type=Path, metavar="DIR")
    dfx.set_defaults(importer=import_dfx_mgr)
    pynq = formats.add_parser("pynq", help="make a schema of a PYNQ overlay: a .bit with its .hwh beside it")
    pynq.add_argument("source", type=Path, metavar="FILE.bit")
    pynq.add_argument("--hwh", type=Path, metavar="FILE", help="its .hwh (default: beside it, of the same name)")
    pynq.set_defaults(importer=import_pynq)
    packed = formats.add_parser("archive", help="unpack an archive of `cm build collect` on the board")
    packed.add_argument("source", type=Path, metavar="FILE.tar.gz")
    packed.add_argument(
        "--out", type=Path, metavar="DIR", default=FIRMWARE, help=f"unpack below this folder ({FIRMWARE})"
    )
    packed.add_argument(
        "--settings", type=Path, metavar="FILE", help="settings whose policy of signatures applies (/etc/cm/cm.yaml)"
    )
    add_json_option(packed, run_archive)
    for each in (dfx, pynq):
        each.add_argument(
            "--out", type=Path, metavar="DIR", help="write the schemas into this folder (default: print them)"
        )
        each.add_argument(
            "--force", action="store_true", help="replace schemas that were edited, or are of another package"
        )
        add_json_option(each, run)


def run(args: argparse.Namespace) -> int:
    """Import; 0 unless the package is refused."""
    more = {"hwh": args.hwh, "make": _overlay_of if args.out else None} if args.format == "pynq" else {}
    imported: Imported = args.importer(args.source, **more)
    files = []
    if args.out:
        with naming(args.out):
            files = write(imported, args.out, args.force)
    if args.json:
        print_json(_report(imported, files))
        return 0
    for path in files:
        print(f"{path}: written")
    if not files:
        print("---\n".join(dump(config) for config in imported.configs), end="")
    for note in imported.notes:
        print(f"# not carried over: {note}" if not files else f"  note: {note}")
    return 0


def _overlay_of(design: Any, config: Any, names: Any, notes: list[str]) -> dict[str, bytes]:
    """As `cm build collect` makes it; nothing, and a note, where that is not installed."""
    try:
        from cm.design.collect.foreign import overlay_of
    except ImportError as error:
        notes.append(f"no overlay was made: {error} ({installing('build')})")
        return {}
    try:
        return overlay_of(design, config, names, notes)
    except CmError as error:
        notes.append(f"no overlay was made: {error}")
        return {}


def run_archive(args: argparse.Namespace) -> int:
    """Unpack; 0 unless the archive is refused."""
    with naming(args.out):
        done, found = unpack_signed(args.source, args.out, args.settings)
    told = {key: value for key, value in (("signer", found.signer), ("warning", found.warning)) if value}
    if not args.json and found.warning:
        print(f"warning: {found.warning}", file=sys.stderr)
    elif not args.json and found.signer:
        print(f"{args.source}: signed by {found.signer}, version {found.version}")
    counts = f"{len(done.config.modules)} modules, {len(done.config.modes)} modes, {len(done.files)} files"
    answered = {"config": done.config.name, "folder": str(done.folder), "files": list(done.files), **told}
    return answer(args, answered, f"{done.folder}: configuration {done.config.name}, {counts}")


def unpack_signed(archive: Path, out: Path, settings: Path | None) -> tuple[Unpacked, Judgement]:
    """Unpack an archive under the settings' policy of signatures, and keep as many earlier versions as they say.

    Raises what `unpack` does, and SignatureRefused.
    """
    from cm.cli.signature_policy import policy_of
    from cm.formats.signing import Judgement, judge

    said = read_settings(settings)
    policy, found = policy_of(said), [Judgement()]

    def asked(folder: Path, name: str, installed: Path) -> None:
        found.append(judge(folder, name, policy, installed))

    return unpack(archive, out, said.imports.keep, asked), found[-1]


def read_settings(path: Path | None) -> Settings:
    """The settings that are named, else the system's, where there are some."""
    from cm.server.settings.model import FILE

    if path is None and not FILE.exists():
        return Settings()
    from cm.server.settings.loader import load_settings

    return load_settings(path or FILE)


def _report(imported: Imported, files: list[Path]) -> dict[str, object]:
    return {
        "configs": [config.name for config in imported.configs],
        "files": [str(path) for path in files],
        "schemas": {config.name: dump(config) for config in imported.configs},
        "notes": list(imported.notes),
    }
