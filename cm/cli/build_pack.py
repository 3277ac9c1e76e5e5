# SPDX-License-Identifier: Apache-2.0
"""``cm build pack`` and ``cm build unpack``: the flow on another host than the designer's."""

from __future__ import annotations

import argparse
from pathlib import Path

from cm.cli.build_common import add_out_option, add_schema_argument
from cm.cli.common import add_json_option, print_json
from cm.design.errors import BuildError
from cm.design.generate.tree import behind, load_design, output_folder
from cm.design.project.load import load_project
from cm.design.project.model import Project
from cm.design.run.pack import pack
from cm.design.run.unpack import unpack


def add_pack_parsers(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add both actions."""
    parser = actions.add_parser(
        "pack",
        help="pack the generated flow with everything it reads for a host with Vivado",
        description="The other host needs neither this package nor Python: extract the archive, run "
        "make in its build folder, then make back, and pass back.tar.gz to cm build "
        "unpack.",
    )
    add_schema_argument(parser)
    add_out_option(parser)
    parser.add_argument("-f", "--file", type=Path, metavar="FILE", help="the archive (default: NAME-flow.tar.gz)")
    more = "only this module in its region's abstract shell, nothing of the static design (may be repeated)"
    parser.add_argument("--module", action="append", default=[], metavar="NAME", help=more)
    add_json_option(parser)
    parser.set_defaults(run=run_pack)
    parser = actions.add_parser(
        "unpack",
        help="unpack the results of a packed flow",
        description="Take stamps, logs, reports, checkpoints and bitstreams of an archive (make back) or of a folder"
        " that was copied back. Nothing is taken if a file that the steps read has changed since it was packed.",
    )
    parser.add_argument("source", type=Path, metavar="BACK", help="back.tar.gz, or the folder")
    add_schema_argument(parser)
    add_out_option(parser)
    add_json_option(parser)
    parser.set_defaults(run=run_unpack)


def run_pack(args: argparse.Namespace) -> int:
    """Write the archive."""
    design = load_design(args.schema)
    project, out = design.project, output_folder(design.project, args.out)
    stale = behind(design, out)
    if stale:
        raise BuildError(
            f"{', '.join(stale[:3])} in {out} would be generated otherwise now: run cm build generate first"
        )
    archive = args.file or Path(f"{'-'.join([project.name, *args.module])}-flow.tar.gz")
    done = pack(out, project.name, _folders(project, args.module), archive.absolute(), args.module)
    if args.json:
        print_json({"archive": str(archive), "steps": list(done.steps), "files": done.files})
        return 0
    print(f"{archive}: {done.files} files, steps {', '.join(done.steps)}")
    print("there: tar -xf it, make -j4 VIVADO=/path/to/vivado in the folder with pack.json, make back")
    print("here: cm build unpack back.tar.gz")
    return 0


def _folders(project: Project, modules: list[str]) -> list[Path]:
    """Folders that steps read as a whole: include folders, and those of IP."""
    found = [] if modules else list(project.static.include_dirs)
    for module in project.modules.values():
        names = {module.name, *(f"{module.name}_{region}" for region in module.regions)}
        if modules and not names & set(modules):
            continue
        found += [*module.include_dirs, *module.ip_repositories, *(path.parent for path in module.ip)]
    return list(dict.fromkeys(found))


def run_unpack(args: argparse.Namespace) -> int:
    """Take back what came."""
    out = output_folder(load_project(args.schema), args.out)
    found = unpack(args.source, out)
    if args.json:
        print_json({"done": list(found.done), "left": list(found.left), "files": found.files})
    else:
        print(f"{out}: {found.files} files of {len(found.done)} steps")
        for name in found.left:
            print(f"note: step {name} was not run to its end there")
    return 1 if found.left else 0
