# SPDX-License-Identifier: Apache-2.0
"""``cm completion bash|zsh|fish``: a static completion script, made from the parser.

The script starts no Python when Tab is pressed; it is made anew when `cm` is upgraded.
"""

from __future__ import annotations

import argparse
from importlib import import_module

from cm.cli.completion.tree import command_tree

SHELLS = ("bash", "zsh", "fish")
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
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("shell", choices=SHELLS)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print the script."""
    print(script(args.shell), end="")
    return 0


def script(shell: str) -> str:
    """The completion script for `shell`, one of `SHELLS`."""
    from cm.cli.parser import build_full_parser

    text: str = import_module(f"{__name__}.{shell}").script(command_tree(build_full_parser()))
    return text
