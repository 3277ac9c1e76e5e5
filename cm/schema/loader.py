# SPDX-License-Identifier: Apache-2.0
"""`load`, `loads`, `load_folder`, `check`: files → configurations, or everything that is wrong with them."""

from __future__ import annotations

import json
import re
from functools import lru_cache
from pathlib import Path
from typing import Any

from cm.errors import NotFound
from cm.frozen import replace
from cm.hashes import sha256
from cm.schema.construct import Context, build_config
from cm.schema.model import Config
from cm.schema.problems import MAX_PROBLEMS, KeyPath, Problem, SchemaError, key_path
from cm.schema.reader import Refused, read
from cm.schema.rules import check_rules
from cm.schema.structure import SCHEMA_FILE, Structure, load_structure
from cm.schema.tree import Mark, Node, Table, locate, plain

MAX_FILE_BYTES = 1 << 20
_CONFIG = re.compile(rb"^[{ ]*[\"']?config[\"']?\s*:", re.MULTILINE)
_SURELY = re.compile(rb"^config:", re.MULTILINE)  # at the beginning of a line: a key of the whole
SUFFIXES = (".yaml", ".yml")


def load(path: Path | str) -> Config:
    """The configuration in the file at `path`.

    Raises `SchemaError` with everything that is wrong, `NotFound` if there is no such file.
    """
    path = Path(path)
    data = _bytes(path)
    text = decoded(data, path)
    # absolute, so that files beside it are found from any working directory
    return replace(loads(text, path), source=path.absolute(), sha256_source=sha256(data))


def decoded(data: bytes, path: Path) -> str:
    """The text in `data` of the file at `path`. Raises `SchemaError` with the line that is not UTF-8."""
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        problem = Problem(path, line, 1, "", "yaml_syntax", "not UTF-8 text", "save the file as UTF-8")
        raise SchemaError([problem]) from None


def loads(text: str, source: Path | str | None = None) -> Config:
    """The configuration in `text`; `source` names the file that it came from, for messages and look-ups."""
    path = None if source is None else Path(source)
    loading = Loading(text, path, _structure())
    data, context = loading.usable()["config"], Context(loading.report)
    config = build_config(data, context)
    check_rules(config, context)
    loading.stop_if_wrong()
    return replace(config, source=path, sha256_source=sha256(text.encode()))


def load_folder(path: Path | str) -> dict[str, Config]:
    """All configurations in the folder at `path` by name, in the order of file names.

    Files ``*.yaml`` and ``*.yml`` without ``config:`` are not schemas, and are left out. Two files with
    one name of configuration are an error that names both.
    """
    found: dict[str, Config] = {}
    problems: list[Problem] = []
    for file in schema_files(path):
        try:
            config = load(file)
        except SchemaError as error:
            problems += error.problems
            continue
        first = found.setdefault(config.name, config)
        if first is not config:
            message = f"configuration {config.name} is already in {first.source}"
            problems.append(Problem(file, 1, 1, "config.name", "duplicate_name", message, "give one another name"))
    if problems:
        raise SchemaError(problems)
    return found


def schema_files(path: Path | str) -> list[Path]:
    """The files in a folder that hold a runtime schema, in order of their names."""
    folder = Path(path)
    if not folder.is_dir():
        raise NotFound(f"{folder}: no such folder")
    files = sorted(file for file in folder.iterdir() if file.suffix in SUFFIXES and file.is_file())
    return [file for file in files if _is_schema(file)]


def check(path: Path | str) -> list[Problem]:
    """What is wrong with the file at `path`; empty if all is well."""
    try:
        load(path)
    except SchemaError as error:
        return list(error.problems)
    return []


def json_schema() -> dict[str, Any]:
    """The JSON Schema (draft-07) of the normal form, for editors and tools."""
    schema: dict[str, Any] = json.loads(SCHEMA_FILE.read_text())
    return schema


def _bytes(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            return file.read(MAX_FILE_BYTES + 1)
    except FileNotFoundError:
        raise NotFound(f"{path}: no such file") from None
    except OSError as error:
        problem = Problem(path, 0, 0, "", "unreadable", error.strerror or str(error), "a runtime schema is a text file")
        raise SchemaError([problem]) from None


def _is_schema(file: Path) -> bool:
    """Whether `file` has a ``config:``; if it is not valid YAML, whether it looks as if it should have one."""
    try:
        data = _bytes(file)
        if _SURELY.search(data):  # then it is not read twice
            return True
        tree = read(data.decode("utf-8-sig"), lambda *_: None)
    except SchemaError:
        return True  # cannot be read: to be reported as such
    except (Refused, UnicodeDecodeError):
        return _CONFIG.search(data) is not None
    return isinstance(tree, Table) and "config" in tree.entries


@lru_cache(maxsize=1)
def _structure() -> Structure:
    return load_structure()


class Loading:
    """One text on its way to plain values, and all that is wrong with it."""

    def __init__(self, text: str, source: Path | None, structure: Structure) -> None:
        self._text, self.source, self._structure = text, source, structure
        self._problems: list[Problem] = []
        self.given: Node = Table(Mark(1, 1))  # as it stands in the file; `_root`: in normal form
        self._root: Node = self.given
        self._partial = False  # what is looked at is only what is left of it

    def values(self) -> dict[str, Any]:
        """The values in normal form. Raises `SchemaError` with everything in which they differ from the JSON Schema."""
        found = self.usable()
        self.stop_if_wrong()
        return found

    def usable(self) -> dict[str, Any]:
        """The values in normal form, without those that differ from the JSON Schema: these are reported.

        After that, only what cannot come of what is missing is reported (`_sure`). Raises `SchemaError` if too little
        is left.
        """
        try:
            tree = read(self._text, self._report_mark)
        except Refused as refused:
            self._report_mark(refused.mark, refused.code, refused.message, refused.hint)
            raise self._error() from None
        self.stop_if_wrong()
        self.given = tree
        self._root = self._structure.fit(tree, self.report_at)
        wrong = self._structure.values(self._root)
        for finding in wrong:
            self.report(*finding)
        if self._problems:
            self._partial = True
            left = self._structure.usable(self._root, [finding.path for finding in wrong])
            if left is None:
                raise self._error()
            self._root = left
        found: dict[str, Any] = plain(self._root)
        return found

    def _sure(self, code: str, message: str) -> bool:
        """Whether a problem is there in any case: a file, or a name that the text has nowhere else.

        Not registers, which other files may define.
        """
        if code in ("unknown_mode", "unknown_module", "unknown_region"):
            name = re.search(r"\w+", message.removeprefix(f"there is no {code[8:]} "))
            return name is not None and len(re.findall(rf"\b{name[0]}\b", self._text)) == 1
        return code == "file_not_found"

    def report(self, path: KeyPath, code: str, message: str, hint: str = "") -> None:
        """Report a problem with the key at `path`."""
        self.report_at(locate(self._root, path), path, code, message, hint)

    def report_at(self, mark: Mark, path: KeyPath, code: str, message: str, hint: str) -> None:
        """Report a problem at a position."""
        if self._partial:
            if not self._sure(code, message):
                return
            hint = "" if hint.startswith(("there are none", "known: ")) else hint  # of all, when it is mended
        problem = Problem(self.source, mark.line, mark.column, key_path(path), code, message, hint)
        self._problems.append(problem)
        if len(self._problems) >= MAX_PROBLEMS:
            raise self._error()

    def stop_if_wrong(self) -> None:
        """Raise `SchemaError` with the problems so far, if there are any, in the order of the file."""
        if self._problems:
            raise self._error()

    def _report_mark(self, mark: Mark, code: str, message: str, hint: str) -> None:
        self.report_at(mark, (), code, message, hint)

    def _error(self) -> SchemaError:
        return SchemaError(sorted(self._problems, key=lambda problem: (problem.line, problem.column)))
