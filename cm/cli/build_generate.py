# SPDX-License-Identifier: Apache-2.0
"""``cm build generate|configure``: what the tools and the target need, and the decisions that only a person makes."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from cm.cli.build import add_out_option, add_schema_argument
from cm.cli.common import add_json_option, print_json
from cm.design.errors import BuildError
from cm.design.generate.generation import ANSWERS, generate, load_design, output_folder
from cm.design.generate.output_tree import Written
from cm.design.runtime.answers import read_answers
from cm.design.runtime.configure import answer_all, as_text, questions, to_answers


def fill_generate(parser: argparse.ArgumentParser) -> None:
    """Describe the action."""
    parser.description = (
        "Write everything that the vendor's tools and the target need. A file that you "
        "changed is never overwritten: the new version is written beside it as FILE.new, "
        "and the version that you started from is kept in .cm-orig/."
    )
    add_schema_argument(parser)
    add_out_option(parser)
    add_json_option(parser, run_generate)


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


def fill_configure(parser: argparse.ArgumentParser) -> None:
    """Describe the action."""
    parser.description = (
        "Ask on the terminal, with defaults. The answers are kept in answers.yaml in the "
        "output folder, used by every later generate, and offered as defaults the next "
        "time. With --answers or --defaults, nothing is asked."
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
