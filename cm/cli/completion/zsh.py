# SPDX-License-Identifier: Apache-2.0
"""The completion script for zsh."""

from __future__ import annotations

import shlex
from collections.abc import Iterable

from cm.cli.completion.tree import Word

_SCRIPT = """\
#compdef cm
# zsh completion for cm, made by `cm completion zsh`
_cm_names() {{  # of what runs
    local -a found=("${{(@f)$($words[1] completion names "${{(@)words[2,CURRENT]}}" 2>/dev/null)}}")
    found=(${{found:#}})
    (( $#found )) || {{ _files; return }}
    compadd -S '' -- ${{(M)found:#*=}}
    compadd -- ${{found:#*=}}
}}
_cm() {{
    local at=cm prev=${{words[CURRENT-1]}} live= i
    local -a names options
    for ((i = 2; i < CURRENT; i++)); do
        case "$at ${{words[i]}}" in
            {paths}) at="$at ${{words[i]}}" ;;
        esac
    done
    case "$at:$prev" in
{values}
    esac
    case "$at" in
{words}
    esac
    if [[ $PREFIX == -* ]]; then
        _describe option options
    elif [[ -n $live ]] || (( $#names )); then
        (( $#names )) && _describe command names
        [[ -n $live ]] && _cm_names
    else
        _files
    fi
}}
if [[ $funcstack[1] == _cm ]]; then _cm "$@"; else compdef _cm cm; fi
"""


def script(tree: Word) -> str:
    """The script for the commands of `tree`. Where nothing is known, zsh completes file names."""
    words = list(tree.walk())
    paths = "|".join(_pattern(word.path) for word in words if word is not tree)
    return _SCRIPT.format(
        paths=paths,
        values="\n".join(line for word in words for line in _values(word)),
        words="\n".join(_words(word) for word in words),
    )


def _pattern(text: str) -> str:
    return f'"{text}"'


def _values(word: Word) -> Iterable[str]:
    """What may follow an option that takes a value."""
    for option in word.options:
        if option.takes_value:
            patterns = "|".join(_pattern(f"{word.path}:{name}") for name in option.names)
            reply = f"compadd -- {shlex.join(option.choices)}" if option.choices else "_files"
            reply = "_cm_names" if option.live else reply
            yield f"        {patterns}) {reply}; return ;;"


def _words(word: Word) -> str:
    names = [_described(child.name, child.help) for child in word.children]
    names += [_described(choice, "") for choice in word.choices]
    options = [_described(name, option.help) for option in word.options for name in option.names]
    live = " live=1" if word.live else ""
    return f"        {_pattern(word.path)}) names=({' '.join(names)}) options=({' '.join(options)}){live} ;;"


def _described(name: str, text: str) -> str:
    name = name.replace(":", "\\:")
    return shlex.quote(f"{name}:{text}" if text else name)
