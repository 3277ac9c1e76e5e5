# SPDX-License-Identifier: Apache-2.0
"""The manual pages cm(1), cm-serve(8) and cm.yaml(5), from the parser and the settings' schema.

python release/manpages.py FOLDER     as roff, for man(1)
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cm._version import __version__
from cm.cli.commands import COMMANDS
from cm.cli.parser import build_full_parser

SETTINGS = Path(__file__).resolve().parents[1] / "cm/server/settings/settings.schema.json"


@dataclass(frozen=True, slots=True)
class Item:
    """A piece of a page: a heading, a paragraph, a term with its text, or lines that stay as they are."""

    kind: str  # heading, text, term, lines
    text: str
    term: str = ""


@dataclass(frozen=True, slots=True)
class Page:
    """A manual page."""

    name: str
    section: int
    about: str
    items: tuple[Item, ...]

    @property
    def file(self) -> str:
        """``cm.1``"""
        return f"{self.name}.{self.section}"


def pages() -> tuple[Page, ...]:
    """All of them."""
    commands = _commands(build_full_parser())
    serve = commands["serve"]
    return (
        Page("cm", 1, "configuration manager for adaptive FPGA systems", tuple(_all(commands))),
        Page(
            "cm-serve",
            8,
            "run the configuration manager",
            (
                *_command(serve),
                *_options(serve),
                Item("heading", "Files"),
                *_FILES,
                Item("heading", "Signals"),
                *_SIGNALS,
            ),
        ),
        Page("cm.yaml", 5, "settings of the configuration manager's service", tuple(_settings())),
    )


_FILES = (
    Item("term", "settings of the service: cm.yaml(5)", "/etc/cm/cm.yaml"),
    Item("term", "runtime schemas and their bitstreams", "/etc/cm/configs, /lib/firmware/cm"),
    Item("term", "keys for TCP, made by `cm keygen`", "/etc/cm/keys"),
    Item("term", "sockets", "/run/cm"),
    Item("term", "what a manager that starts again has to know", "/var/lib/cm"),
)
_SIGNALS = (
    Item("term", "end; the programmable logic stays as it is", "SIGTERM, SIGINT"),
    Item("term", "read settings, keys and schemas again", "SIGHUP"),
)
_ENVIRONMENT = (
    Item("term", "the manager to talk to, as --connect", "CM_CONNECT"),
    Item("term", "the client's key file, as --keys", "CM_KEYS"),
    Item("term", "folder of the manager's sockets, as --runtime-dir", "CM_RUNTIME_DIR"),
    Item("term", "folder of the nodes of a simulated board; default: /", "CM_ROOT"),
    Item("term", "the lease under which commands change something", "CM_LEASE"),
    Item("term", "the fleet's router, as --router", "CM_FLEET"),
    Item("term", "where the fleet's wanted state is, as --store", "CM_FLEET_STORE"),
    Item("term", "no colours, or colours in files and pipes too", "NO_COLOR, FORCE_COLOR"),
)
_STATUS = (
    Item("term", "done", "0"),
    Item("term", "refused or failed; the error's code stands behind the sentence: [unknown_mode]", "1"),
    Item("term", "wrong usage", "2"),
    Item("term", "interrupted by Ctrl-C", "130"),
)


def _commands(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            return dict(action.choices)
    return {}


def _all(commands: dict[str, argparse.ArgumentParser]) -> Iterator[Item]:
    yield Item("heading", "Synopsis")
    yield Item("lines", "cm COMMAND [OPTIONS]")
    yield Item("heading", "Description")
    yield Item(
        "text",
        "`cm serve` runs the configuration manager, which changes what the programmable logic of an FPGA SoC does; "
        "all other commands talk to it, check its files, or make them.",
    )
    for command in COMMANDS:
        parser = commands.get(command.name)
        if parser is not None and command.name != "serve":
            yield Item("heading", f"cm {command.name}")
            yield from _command(parser)
            yield from _options(parser, heading=False)
            yield from _below(parser)
            if parser.epilog:
                yield Item("lines", parser.epilog)
    yield Item("heading", "Exit status")
    yield from _STATUS
    yield Item("heading", "Environment")
    yield from _ENVIRONMENT
    yield Item("heading", "See also")
    yield Item("text", "cm-serve(8), cm.yaml(5)")


def _below(parser: argparse.ArgumentParser) -> Iterator[Item]:
    for inner in dict.fromkeys(_commands(parser).values()):  # once, also where it has an earlier name too
        yield from _command(inner)
        yield from _options(inner, heading=False)
        yield from _below(inner)


def _command(parser: argparse.ArgumentParser) -> Iterator[Item]:
    usage = parser.format_usage().removeprefix("usage: ").split()
    yield Item("lines", "\n".join(_wrapped(usage)))
    yield Item("text", parser.description or "")


def _wrapped(words: list[str], width: int = 74) -> Iterator[str]:
    line = ""
    for word in words:
        if line and len(line) + len(word) >= width:
            yield line
            line = "       "
        line = f"{line} {word}".lstrip() if not line.startswith("  ") else f"{line} {word}"
    yield line


def _options(parser: argparse.ArgumentParser, heading: bool = True) -> Iterator[Item]:
    if heading:
        yield Item("heading", "Options")
    for action in parser._actions:
        if isinstance(action, (argparse._HelpAction, argparse._SubParsersAction)) or action.help == argparse.SUPPRESS:
            continue
        format_ = parser._get_formatter()
        value = format_._format_args(action, action.dest.upper()) if action.nargs != 0 else ""
        yield Item(
            "term",
            format_._expand_help(action) if action.help else "",
            f"{', '.join(action.option_strings)} {value}".strip(),
        )


def _settings() -> Iterator[Item]:
    schema = json.loads(SETTINGS.read_text("utf-8"))
    yield Item("heading", "Description")
    yield Item(
        "text",
        "YAML, read by `cm serve` at its start and at SIGHUP from /etc/cm/cm.yaml; options of the command override it. "
        "`cm config check --settings` checks it.",
    )
    yield Item("heading", "Keys")
    yield from _keys(schema, schema["definitions"], "")
    yield Item("heading", "See also")
    yield Item("text", "cm-serve(8), cm(1)")


def _keys(shape: dict[str, Any], definitions: dict[str, Any], before: str) -> Iterator[Item]:
    for key, value in shape.get("properties", {}).items():
        found = value
        while "$ref" in found:
            found = {**definitions[found["$ref"].rsplit("/", 1)[1]], **{k: v for k, v in found.items() if k != "$ref"}}
        default = f" Default: {json.dumps(found['default'], ensure_ascii=False)}." if "default" in found else ""
        text = (found.get("description", "") + default).strip()
        if text or "properties" not in found:
            yield Item("term", text, before + key)
        yield from _keys(found, definitions, f"{before}{key}.")


def roff(page: Page) -> str:
    """For man(1)."""
    lines = [
        '.\\" SPDX-License-' + "Identifier: Apache-2.0",  # in two, as it is the page's and not this file's
        f'.TH {page.name} {page.section} "" "fpga-cm {__version__}" "{_TITLES[page.section]}"',
        ".SH NAME",
        f"{_escaped(page.name)} \\- {_escaped(page.about)}",
    ]
    for item in page.items:
        text = _escaped(item.text)
        if item.kind == "heading":
            lines.append(f'.SH "{text.upper()}"')
        elif item.kind == "lines":
            lines += [".PP", ".nf", *text.splitlines(), ".fi"]
        elif item.kind == "term":
            lines += [".TP", f"\\fB{_escaped(item.term)}\\fR", *(text.splitlines() or ["\\&"])]
        else:
            lines += [".PP", re.sub(r"`([^`]+)`", r"\\fB\1\\fR", text)]
    return "\n".join(lines) + "\n"


_TITLES = {1: "User commands", 5: "File formats", 8: "System administration"}


def _escaped(text: str) -> str:
    text = text.replace("\\", "\\e").replace("-", "\\-")
    return re.sub(r"^([.'])", r"\\&\1", text, flags=re.MULTILINE)


def markdown(page: Page) -> str:
    """For the site."""
    lines = [f"# {page.name}({page.section})", "", f"{page.about[:1].upper()}{page.about[1:]}.", ""]
    rows = False
    for item in page.items:
        if item.kind == "term":
            lines += [] if rows else ["| | |", "|---|---|"]
            lines.append(f"| `{_cell(item.term)}` | {_cell(item.text)} |")
            rows = True
            continue
        lines += [""] if rows else []
        rows = False
        if item.kind == "heading":
            lines += [f"## {item.text}", ""]
        elif item.kind == "lines":
            lines += ["```text", *item.text.splitlines(), "```", ""]
        else:
            lines += [item.text, ""]
    return "\n".join(lines) + "\n"


def _cell(text: str) -> str:
    return " ".join(text.replace("|", "\\|").replace("<", "&lt;").replace("*", "\\*").split())


def write(folder: Path, made: Iterable[Page], as_text: Any, suffix: str = "") -> None:
    """Each page into a file of its name."""
    folder.mkdir(parents=True, exist_ok=True)
    for page in made:
        (folder / f"{page.file}{suffix}").write_text(as_text(page), "utf-8")


if __name__ == "__main__":
    write(Path(sys.argv[1]), pages(), roff)
