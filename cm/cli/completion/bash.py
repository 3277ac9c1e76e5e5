# SPDX-License-Identifier: Apache-2.0
"""The completion script for bash."""

from __future__ import annotations

import shlex
from collections.abc import Iterable

from cm.cli.completion.tree import Word

_SCRIPT = """\
# bash completion for cm, made by `cm completion bash`
_cm_names() {{  # of what runs; bash took the word apart at =
    local line=${{COMP_LINE:0:COMP_POINT}} found
    local -a typed
    read -ra typed <<< "$line"
    [[ $line == *[[:space:]] ]] && typed+=("")
    found=$("${{typed[0]}}" completion names "${{typed[@]:1}}" 2>/dev/null) || return
    local last=${{typed[-1]}}
    [[ $last == *=* ]] && found=${{found//"${{last%%=*}}="/}}
    COMPREPLY+=($found)
    [[ ${{COMPREPLY[0]-}} == *= ]] && compopt -o nospace 2>/dev/null
}}
_cm() {{
    local cur=${{COMP_WORDS[COMP_CWORD]}} prev=${{COMP_WORDS[COMP_CWORD-1]}} at=cm words= options= live= i
    COMPREPLY=()
    for ((i = 1; i < COMP_CWORD; i++)); do
        case "$at ${{COMP_WORDS[i]}}" in
            {paths}) at="$at ${{COMP_WORDS[i]}}" ;;
        esac
    done
    case "$at:$prev" in
{values}
    esac
    case "$at" in
{words}
    esac
    [[ $cur == -* ]] && words=$options
    COMPREPLY=($(compgen -W "$words" -- "$cur"))
    [[ $live && $cur != -* ]] && _cm_names
}}
complete -o bashdefault -o default -F _cm cm
"""


def script(tree: Word) -> str:
    """The script for the commands of `tree`. Where nothing is known, bash completes file names."""
    words = list(tree.walk())
    paths = "|".join(shlex.quote(word.path) for word in words if word is not tree)
    return _SCRIPT.format(
        paths=paths,
        values="\n".join(line for word in words for line in _values(word)),
        words="\n".join(_words(word) for word in words),
    )


def _values(word: Word) -> Iterable[str]:
    """What may follow an option that takes a value."""
    for option in word.options:
        if option.takes_value:
            patterns = "|".join(shlex.quote(f"{word.path}:{name}") for name in option.names)
            choices = shlex.quote(" ".join(option.choices))
            reply = f'COMPREPLY=($(compgen -W {choices} -- "$cur")); ' if option.choices else ""
            yield f"        {patterns}) {reply}{'_cm_names; ' if option.live else ''}return ;;"


def _words(word: Word) -> str:
    names = [child.name for child in word.children] + list(word.choices)
    options = [name for option in word.options for name in option.names]
    words, spellings = shlex.quote(" ".join(names)), shlex.quote(" ".join(options))
    return f"        {shlex.quote(word.path)}) words={words} options={spellings}{' live=1' if word.live else ''} ;;"
