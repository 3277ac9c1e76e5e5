# SPDX-License-Identifier: Apache-2.0
"""C++ as text: a function's arguments and body, its interface pragmas, which streams it reads or writes."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from cm.design.hdl.errors import HdlError
from cm.design.hdl.hls_types import split

_COMMENT = re.compile(r"//[^\n]*|/\*.*?\*/|\"(?:\\.|[^\"\\\n])*\"", re.DOTALL)
_PRAGMA = re.compile(r"^[ \t]*#[ \t]*pragma[ \t]+HLS[ \t]+INTERFACE[ \t]+([^\n]*)", re.MULTILINE | re.IGNORECASE)
_MODES = ("axis", "m_axi", "s_axilite", "ap_none", "ap_vld", "ap_ack", "ap_hs", "ap_ovld", "ap_stable", "ap_memory",
          "ap_fifo", "bram", "ap_ctrl_none", "ap_ctrl_hs", "ap_ctrl_chain")  # fmt: skip
_FUNCTION = r"\b{name}\s*\("


@dataclass(frozen=True, slots=True)
class Declared:
    """An argument as declared; `type` without its name."""

    name: str
    type: str
    indirect: bool
    constant: bool


@dataclass(frozen=True, slots=True)
class Definition:
    """A function with its body."""

    line: int
    arguments: list[Declared]
    body: str


def clean(text: str) -> str:
    """Remove comments; string literals (of includes too) and line numbers stay."""
    return _COMMENT.sub(lambda found: found[0] if found[0][0] == '"' else re.sub(r"[^\n]", " ", found[0]), text)


def only_top(text: str) -> str | None:
    """The only function that has interface pragmas."""
    names = set(re.findall(r"\b(\w+)\s*\([^;{}]*\)\s*\{", text))
    having = [name for name in sorted(names) if (found := definition(text, name)) and _PRAGMA.search(found.body)]
    return having[0] if len(having) == 1 else None


def definition(text: str, name: str) -> Definition | None:
    """The definition of function `name`."""
    for match in re.finditer(_FUNCTION.format(name=re.escape(name)), text):
        end = _closing(text, match.end() - 1)
        brace = re.compile(r"\s*\{").match(text, end + 1) if end > 0 else None
        if brace is None:
            continue
        last = _closing(text, brace.end() - 1)
        arguments = [_declared(part) for part in split(text[match.end() : end]) if part != "void"]
        line = text.count("\n", 0, match.start()) + 1
        return Definition(line, arguments, text[brace.end() : last if last > 0 else len(text)])
    return None


def _closing(text: str, start: int) -> int:
    """Find the bracket that closes the one at `start`; -1 if there is none."""
    depth = 0
    for index in range(start, len(text)):
        depth += (text[index] in "({[") - (text[index] in ")}]")
        if depth == 0:
            return index
    return -1


def _declared(text: str) -> Declared:
    text = " ".join(text.split("=")[0].split())
    array = re.search(r"\b(\w+)\s*((?:\[[^\]]*\]\s*)+)$", text)
    words = re.findall(r"\w+", text)
    if not words:
        raise HdlError(f"an argument is not understood: {text or 'it is empty'}")
    name = array[1] if array else words[-1]
    kind = text[: array.start()] if array else text[: text.rindex(name)]
    indirect = bool(array) or "&" in kind or "*" in kind
    return Declared(name, kind.strip(), indirect, bool(re.search(r"\bconst\b", kind)))


def pragmas(body: str) -> dict[str, dict[str, str]]:
    """Read the settings of each argument; m_axi and s_axilite of one are merged, with `lite` as the slave's bundle."""
    found: dict[str, dict[str, str]] = {}
    for line in _PRAGMA.findall(body):
        settings = {key.lower(): value for key, value in re.findall(r"(\w+)\s*=\s*([\w\"]+)", line)}
        words = re.sub(r"\w+\s*=\s*[\w\"]+", " ", line).split()
        mode = settings.pop("mode", None) or next((word.lower() for word in words if word.lower() in _MODES), "")
        port = settings.pop("port", None) or next((w for w in words if w.lower() not in _MODES and w != "register"), "")
        if port:
            _merge(found.setdefault(port, {}), mode.lower(), settings)
    return found


def _merge(have: dict[str, str], mode: str, settings: dict[str, str]) -> None:
    if have.get("mode") == "m_axi" and mode == "s_axilite":
        have["lite"] = settings.get("bundle", "control")
    elif have.get("mode") == "s_axilite" and mode == "m_axi":
        have["lite"] = have.get("bundle", "control")
        have.pop("bundle", None)
        have.update(settings, mode=mode)
    elif have.get("mode") == "s_axilite" and mode.startswith("ap_ctrl"):
        return  # the protocol of a function that is controlled by registers
    elif mode == "s_axilite" and have.get("mode", "").startswith("ap_ctrl"):
        have.update(settings, mode=mode)
    else:
        have.update(settings, mode=mode)


def headers(path: Path, text: str, cflags: str) -> list[Path]:
    """Find the included files, each once, deepest first, in the folders of -I and of the file itself."""
    folders = [path.parent, *(path.parent / name for name in re.findall(r"-I\s*(\S+)", cflags))]
    return list(_headers(text, folders, set()))


def _headers(text: str, folders: list[Path], seen: set[Path]) -> Iterator[Path]:
    for name in re.findall(r'^\s*#\s*include\s*"([^"\n]+)"', text, re.MULTILINE):
        found = next((folder / name for folder in folders if (folder / name).is_file()), None)
        if found is not None and found not in seen:
            seen.add(found)
            inner = clean(found.read_text(encoding="utf-8", errors="replace"))
            yield from _headers(inner, [found.parent, *folders], seen)
            yield found


def uses(name: str, body: str, text: str, stream: bool, depth: int = 0) -> tuple[bool, bool]:
    """Whether `body` reads and writes the argument, directly or in functions of `text` that it passes it to.

    Anything that is not a `stream` counts as read wherever it occurs without being written.
    """
    word = re.escape(name)
    reads = bool(re.search(rf"\b{word}\s*(?:\.\s*(?:read|empty|read_nb)\b|>>)", body))
    writes = bool(re.search(rf"\b{word}\s*(?:\.\s*(?:write|full|write_nb)\b|<<)", body))
    target = rf"(?:\*\s*{word}|\b{word}(?:\s*\[[^\]]*\])*)"
    writes = writes or bool(re.search(rf"{target}\s*(?:[-+*/|&^]|<<|>>)?=(?!=)", body))
    others = re.sub(rf"{target}\s*=(?!=)", " ", re.sub(r"^\s*#[^\n]*", "", body, flags=re.MULTILINE))
    calls = list(re.finditer(r"\b(\w+)\s*(?:<[^;(){}]*>\s*)?\(", others))
    for call in calls:
        inside = split(others[call.end() : _closing(others, call.end() - 1)])
        if depth < 8 and name in [part.lstrip("&* ") for part in inside]:
            inner = definition(text, call[1])
            if inner is None:
                continue
            index = [part.lstrip("&* ") for part in inside].index(name)
            if index < len(inner.arguments):
                more = uses(inner.arguments[index].name, inner.body, text, stream, depth + 1)
                reads, writes = reads or more[0], writes or more[1]
    plain = not stream and re.search(rf"(?<![.\w]){word}\b(?!\s*(?:\.|<<|>>))", others)
    return (reads or (bool(plain) and not writes), writes)
