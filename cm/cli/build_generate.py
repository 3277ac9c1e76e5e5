# SPDX-License-Identifier: Apache-2.0
"""``cm build init|check|generate|configure``: what is done with a build schema."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from cm.cli.build_interfaces import add_define_option
from cm.cli.common import add_json_option, answer, naming, print_json
from cm.design.boundary.analyse import analyse
from cm.design.check.rules import check_system
from cm.design.errors import BuildError
from cm.design.generate.generation import ANSWERS, generate, load_design, output_folder
from cm.design.generate.output_tree import Written
from cm.design.init import DEFAULT_PART, init_text, what_is_missing
from cm.design.openflow.rules import RULE, check_open
from cm.design.plan.planner import plan_system
from cm.design.project.load import SCHEMA_FILE, load_project
from cm.design.project.source_position import Finding
from cm.design.report import as_dict, lines
from cm.design.runtime.answers import Answers, read_answers
from cm.design.runtime.configure import answer_all, as_text, questions, to_answers
from cm.design.runtime.schema import runtime_config
from cm.design.zypr import zypr_text


def add_schema_argument(parser: argparse.ArgumentParser) -> None:
    """The build schema."""
    parser.add_argument(
        "schema", nargs="?", type=Path, default=Path("build.yaml"), metavar="SCHEMA", help="default: build.yaml"
    )


def add_out_option(parser: argparse.ArgumentParser) -> None:
    """The output folder."""
    parser.add_argument("--out", type=Path, metavar="DIR", help="output folder (default: build/ beside the schema)")


def add_init_parser(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the action."""
    parser = actions.add_parser("init", help="write a first build schema for HDL files")
    parser.add_argument(
        "files",
        nargs="+",
        type=Path,
        metavar="FILE",
        help="Verilog, SystemVerilog, VHDL, FuseSoC .core, IP-XACT component.xml, .xci",
    )
    parser.add_argument("--from", dest="kind", choices=("zypr",), help="FILE is a project file of zypr (JSON)")
    parser.add_argument("--output", "-o", type=Path, default=Path("build.yaml"), metavar="FILE")
    parser.add_argument("--name", help="name of the configuration (default: that of the folder)")
    parser.add_argument("--part", default=DEFAULT_PART, help=f"full part (default: {DEFAULT_PART})")
    parser.add_argument("--top", metavar="NAME", help="only this module")
    parser.add_argument("-I", "--include", action="append", default=[], type=Path, metavar="DIR", help="include folder")
    add_define_option(parser)
    parser.add_argument(
        "--cores",
        type=Path,
        action="append",
        default=[],
        metavar="DIR",
        help="folder to search for the cores that a .core depends on",
    )
    add_json_option(parser, run_init)


def run_init(args: argparse.Namespace) -> int:
    """Write the schema, and its JSON Schema for editors beside it; a file that is there is not overwritten."""
    output: Path = args.output
    if output.exists():
        raise BuildError(f"{output} exists already; give another name with --output")
    folder = output.absolute().parent
    if args.kind == "zypr":
        if len(args.files) != 1:
            raise BuildError("--from zypr takes one project file")
        text = zypr_text(args.files[0], folder)
    else:
        name = args.name or folder.name
        text = init_text(args.files, folder, name, args.part, args.top, args.cores, args.include, dict(args.define))
    folder.mkdir(parents=True, exist_ok=True)
    with naming(output):
        output.write_text(text, encoding="utf-8")
    editor = folder / SCHEMA_FILE.name
    if not editor.exists():
        editor.write_bytes(SCHEMA_FILE.read_bytes())
    missing = what_is_missing(output.absolute())
    lines = [f"{output}: written; look it through, then: cm build check {output}"]
    lines += [f"not known: {sentence}" for sentence in missing]
    return answer(args, {"schema": str(output), "editor": str(editor), "unknown": missing}, "\n".join(lines))


def add_check_parser(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add ``check``."""
    parser = actions.add_parser("check", help="report what was found in the HDL, and how the modules fit their regions")
    add_schema_argument(parser)
    parser.add_argument(
        "--flow", choices=("vivado", "open"), default="vivado", help="which tools' limits to check (default: vivado)"
    )
    add_json_option(parser, run_check)


def add_generate_parser(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add ``generate``."""
    parser = actions.add_parser(
        "generate",
        help="write wrappers, static part, Tcl, overlays, symbols and the runtime schema",
        description="Write everything that the vendor's tools and the target need. A file that you "
        "changed is never overwritten: the new version is written beside it as FILE.new, "
        "and the version that you started from is kept in .cm-orig/.",
    )
    add_schema_argument(parser)
    add_out_option(parser)
    add_json_option(parser, run_generate)


def run_check(args: argparse.Namespace) -> int:
    """Print the report; 1 if a module does not fit, or cannot be synthesised."""
    project = load_project(args.schema)
    analysis = analyse(project)
    system = None if analysis.refused else plan_system(analysis.completed(project), analysis.boundaries)
    if system is not None:
        runtime_config(system, Answers())  # raises where registers have no interface, or a mode names no stream
    found = check_system(system) if system is not None else []
    if system is not None and args.flow == "open":
        found += check_open(system)
        if not any(finding.error for finding in found):
            from cm.design.openflow.relocatable_modules import check_moved  # takes the database's modules along

            found += check_moved(system)
    told = [{"rule": f.rule, "error": f.error, "message": f.text(project.source)} for f in found]
    text = [*lines(project, analysis, system), *(f"{_judge(f)}: {f.text(project.source)}" for f in found)]
    answer(args, as_dict(project, analysis, system) | {"findings": told}, "\n".join(text))
    return 1 if analysis.refused or analysis.broken or any(finding.error for finding in found) else 0


def _judge(finding: Finding) -> str:
    if not finding.error:
        return "note"
    return "refused by the open tools" if finding.rule == RULE else "would be refused"


def run_generate(args: argparse.Namespace) -> int:
    """Write the files; 1 if some could not be brought up to date without losing changes."""
    design = load_design(args.schema)
    out = output_folder(design.project, args.out)
    done = generate(design, out)
    if args.json:
        print_json({name: getattr(done, name) for name in Written.__slots__} | {"runs": len(design.system.runs)})
        return 1 if done.conflicts else 0
    print(f"{out}: {len(done.created)} new, {len(done.updated)} updated, {len(done.unchanged)} unchanged")
    _print_changes(done, out)
    print(design.system.cover)
    for name, info in design.analysis.modules.items():
        for problem in info.problems:
            print(f"problem of {name}: {problem}")
    for note in design.system.notes:
        print(f"note: {note}")
    return 1 if done.conflicts else 0


def _print_changes(done: Written, out: Path) -> None:
    for name in done.kept:
        print(f"kept your changes: {name}")
    for name in done.conflicts:
        print(f"changed by you and by generation: {name}")
        print(f"  the new text is in {name}.new; merge: git -C {out} merge-file {name} .cm-orig/{name} {name}.new")
    for name in done.removed:
        print(f"removed, no longer generated: {name}")
    for name in done.left:
        print(f"no longer generated, left because you changed it: {name}")


def add_configure_parser(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the action."""
    parser = actions.add_parser(
        "configure",
        help="ask for the decisions that the runtime schema needs",
        description="Ask on the terminal, with defaults. The answers are kept in answers.yaml in the "
        "output folder, used by every later generate, and offered as defaults the next "
        "time. With --answers or --defaults, nothing is asked.",
    )
    add_schema_argument(parser)
    add_out_option(parser)
    choice = parser.add_mutually_exclusive_group()
    choice.add_argument(
        "--answers", type=Path, metavar="FILE", help="take the answers from this file, and defaults for the rest"
    )
    choice.add_argument("--defaults", action="store_true", help="take the earlier answers, and defaults for the rest")
    parser.set_defaults(run=run_configure)


def _ask(prompt: str) -> str:
    try:
        return input(prompt)
    except EOFError:
        print()
        raise BuildError("the input ended before the last question: nothing was written") from None


def run_configure(args: argparse.Namespace) -> int:
    """Ask, keep the answers, generate again."""
    design = load_design(args.schema)
    out = output_folder(design.project, args.out)
    asked = list(questions(design.system))
    if args.answers is not None and not args.answers.exists():
        raise BuildError(f"{args.answers} does not exist")
    source: Path = args.answers or out / ANSWERS
    given = read_answers(source) if args.answers else {}
    earlier = {} if args.answers else read_answers(source)
    interactive = not args.defaults and args.answers is None
    if interactive and not sys.stdin.isatty():
        raise BuildError("there is no terminal to ask on: use --answers FILE or --defaults")
    answers = answer_all(asked, given, _ask if interactive else None, source, earlier)
    for key in earlier.keys() - answers.keys():
        print(f"no longer asked: {key}: {earlier[key]}")
    out.mkdir(parents=True, exist_ok=True)
    (out / ANSWERS).write_text(as_text(answers, asked), encoding="utf-8")
    done = generate(design, out, to_answers(answers, asked, source))
    print(f"{out / ANSWERS}: {len(asked)} answers; {len(done.created) + len(done.updated)} files brought up to date")
    for name in done.conflicts:
        print(f"changed by you and by generation: {name}; the new text is in {name}.new")
    return 1 if done.conflicts else 0
