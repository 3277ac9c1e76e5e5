# SPDX-License-Identifier: Apache-2.0
"""``cm import dfx-mgr|pynq|archive``: runtime schemas from other managers' packages, and our own archives."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from cm.cli.common import add_json_option, print_json
from cm.formats.importers import Imported, import_dfx_mgr, import_pynq, unpack, write
from cm.schema import dump
from cm.server.settings.model import Settings

FIRMWARE = Path("/lib/firmware/cm")  # where the manager looks for a configuration's files


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command."""
    parser = subparsers.add_parser(
        "import",
        help="make a runtime schema from a dfx-mgr or PYNQ package, or unpack an archive",
        description="Make runtime schemas that load another manager's package in place, and report "
        "what could not be carried over; or unpack an archive of `cm build collect`.",
    )
    formats = parser.add_subparsers(dest="format", metavar="FORMAT", required=True)
    dfx = formats.add_parser("dfx-mgr", help="a base folder of dfx-mgr, the one with shell.json")
    dfx.add_argument("source", type=Path, metavar="DIR")
    dfx.set_defaults(importer=import_dfx_mgr)
    pynq = formats.add_parser("pynq", help="a PYNQ overlay: a .bit with its .hwh beside it")
    pynq.add_argument("source", type=Path, metavar="FILE.bit")
    pynq.set_defaults(importer=import_pynq)
    packed = formats.add_parser("archive", help="unpack an archive of `cm build collect` on the board")
    packed.add_argument("source", type=Path, metavar="FILE.tar.gz")
    packed.add_argument(
        "--out", type=Path, metavar="DIR", default=FIRMWARE, help=f"unpack below this folder ({FIRMWARE})"
    )
    packed.add_argument("--keep", type=_count, metavar="N", help="earlier versions to keep for a rollback (default: 3)")
    packed.add_argument(
        "--settings", type=Path, metavar="FILE", help="settings whose policy of signatures applies (/etc/cm/cm.yaml)"
    )
    add_json_option(packed)
    packed.set_defaults(run=run_archive)
    for each in (dfx, pynq):
        each.add_argument(
            "--out", type=Path, metavar="DIR", help="write the schemas into this folder (default: print them)"
        )
        add_json_option(each)
        each.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Import; 0 unless the package is refused."""
    imported: Imported = args.importer(args.source)
    files = write(imported, args.out) if args.out else []
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


def run_archive(args: argparse.Namespace) -> int:
    """Unpack; 0 unless the archive is refused."""
    from cm.cli.signatures import policy_of
    from cm.formats.signing import judge
    from cm.formats.signing.policy import Judgement

    settings = read_settings(args.settings)
    policy, found = policy_of(settings), [Judgement()]

    def asked(folder: Path, name: str, installed: Path) -> None:
        found.append(judge(folder, name, policy, installed))

    done = unpack(args.source, args.out, settings.imports.keep if args.keep is None else args.keep, asked)
    signer, warning = found[-1].signer, found[-1].warning
    if args.json:
        files = list(done.files)
        told = {key: value for key, value in (("signer", signer), ("warning", warning)) if value}
        print_json({"config": done.config.name, "folder": str(done.folder), "files": files, **told})
    else:
        if warning:
            print(f"warning: {warning}", file=sys.stderr)
        elif signer:
            print(f"{args.source}: signed by {signer}, version {found[-1].version}")
        counts = f"{len(done.config.modules)} modules, {len(done.config.modes)} modes, {len(done.files)} files"
        print(f"{done.folder}: configuration {done.config.name}, {counts}")
    return 0


def _count(text: str) -> int:
    if not text.isascii() or not text.isdigit():
        raise argparse.ArgumentTypeError(f"{text!r} is not a number of versions")
    return int(text)


def read_settings(path: Path | None) -> Settings:
    """The settings that are named, else the system's, where there are some."""
    from cm.server.settings.model import FILE

    if path is None and not FILE.exists():
        return Settings()
    from cm.server.settings import load_settings

    return load_settings(path or FILE)


def _report(imported: Imported, files: list[Path]) -> dict[str, object]:
    return {
        "configs": [config.name for config in imported.configs],
        "files": [str(path) for path in files],
        "schemas": {config.name: dump(config) for config in imported.configs},
        "notes": list(imported.notes),
    }
