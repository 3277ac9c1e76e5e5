# SPDX-License-Identifier: Apache-2.0
"""``cm completion bash|zsh|fish``: a completion script, made from the parser.

Commands and options stand in the script, which is made anew when `cm` is upgraded. For the names of what runs
(modes, registers, streams, …) it asks ``cm completion names``.
"""

from __future__ import annotations

import argparse
from importlib import import_module

from cm.cli.common import completes
from cm.cli.completion.tree import command_tree
from cm.cli.help_format import RawHelp

SHELLS = ("bash", "zsh", "fish")
NAMES = "names"  # asked for by the scripts
_EPILOG = """to use it:
  bash  cm completion bash > ~/.local/share/bash-completion/completions/cm
  zsh   cm completion zsh > ~/.zfunc/_cm      (with ~/.zfunc in fpath, before compinit)
  fish  cm completion fish > ~/.config/fish/completions/cm.fish
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command."""
    parser = subparsers.add_parser(
        "completion",
        help="print a completion script for a shell",
        description="Print a completion script for a shell.",
        epilog=_EPILOG,
        formatter_class=RawHelp,
    )
    completes(parser.add_argument("shell", choices=(*SHELLS, NAMES)), *SHELLS)
    parser.add_argument("words", nargs=argparse.REMAINDER, help=f"with `{NAMES}`: a command line after cm; its last "
        "word is completed")  # fmt: skip
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print the script, or names of what runs, one a line; the exit status."""
    if args.shell == NAMES:
        from cm.cli.completion.running import names

        print("".join(f"{name}\n" for name in names(args.words)), end="")
        return 0
    print(script(args.shell), end="")
    return 0


def script(shell: str) -> str:
    """The completion script for `shell`, one of `SHELLS`."""
    from cm.cli.parser import build_full_parser

    text: str = import_module(f"{__name__}.{shell}").script(command_tree(build_full_parser()))
    return text
