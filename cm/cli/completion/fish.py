# SPDX-License-Identifier: Apache-2.0
"""The completion script for fish."""

from __future__ import annotations

from collections.abc import Iterable

from cm.cli.completion.tree import Option, Word

_SCRIPT = """\
# fish completion for cm, made by `cm completion fish`
function __cm_at
    set -l at cm
    for word in (commandline -opc)[2..-1]
        switch "$at $word"
            case {paths}
                set at "$at $word"
        end
    end
    test "$at" = "$argv[1]"
end
function __cm_names
    set -l words (commandline -opc)
    $words[1] completion names $words[2..-1] (commandline -ct) 2>/dev/null
end
complete -c cm -e
{lines}
"""


def script(tree: Word) -> str:
    """The script for the commands of `tree`. Where nothing is known, fish completes file names."""
    words = list(tree.walk())
    paths = " ".join(_quote(word.path) for word in words if word is not tree)
    return _SCRIPT.format(paths=paths, lines="\n".join(line for word in words for line in _lines(word)))


def _lines(word: Word) -> Iterable[str]:
    here = f"complete -c cm -n {_quote(f'__cm_at {_quote(word.path)}')}"
    for child in word.children:
        yield f"{here} -f -a {_quote(child.name)} -d {_quote(child.help)}"
    if word.choices:
        yield f"{here} -f -a {_quote(' '.join(word.choices))}"
    if word.live:
        yield f"{here}{'' if word.files else ' -f'} -a '(__cm_names)'"
    for option in word.options:
        yield f"{here} {_option(option)}"


def _option(option: Option) -> str:
    words = [f"-l {name[2:]}" if name.startswith("--") else f"-s {name[1:]}" for name in option.names]
    if option.live:
        words.append("-x -a '(__cm_names)'")
    elif option.choices:
        words.append(f"-x -a {_quote(' '.join(option.choices))}")
    elif option.takes_value:
        words.append("-r")
    return " ".join([*words, "-d", _quote(option.help)])


def _quote(text: str) -> str:
    """Quoted for fish: in single quotes only backslash and quote are special."""
    escaped = text.replace("\\", "\\\\").replace("'", "\\'")
    return f"'{escaped}'"
