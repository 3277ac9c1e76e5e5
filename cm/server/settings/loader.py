# SPDX-License-Identifier: Apache-2.0
"""The settings of a file: read, checked against their schema, and made into data."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar

from cm.errors import CmError, InvalidRequest
from cm.frozen import names, replace
from cm.schema.problems import KeyPath, Problem, SchemaError, did_you_mean, key_path
from cm.schema.reader import Refused, read
from cm.schema.structure import Structure
from cm.schema.tree import Mark, Node, Table, locate, plain
from cm.server.rights.model import Access, Grant, Role
from cm.server.settings.model import (
    FILE,
    DmaSettings,
    ImportSettings,
    LimitSettings,
    PolicySettings,
    RecordSettings,
    ScrubSettings,
    Settings,
    StreamSettings,
)
from cm.wire.topics import split_tcp

_PEOPLE = ("users", "groups", "guests")
_LISTS = ("local", "insecure")


def access(values: Mapping[str, Any]) -> Access:
    """The data for values that have been checked against the schema."""
    known = dict(values)
    if "keys" in known:
        known["keys_folder"] = Path(known.pop("keys"))
    known |= {name: tuple(known[name]) for name in _LISTS if name in known}
    for name in (name for name in _PEOPLE if name in known):
        known[name] = MappingProxyType({who: tuple(roles) for who, roles in known[name].items()})
    if "roles" in known:
        roles = {}
        for name, said in known["roles"].items():
            patterns = {key: tuple(found) for key, found in said.items() if key != "role"}
            roles[name] = Grant(Role[said["role"].upper()], **patterns)
        known["roles"] = MappingProxyType(roles)
    return Access(**known)


def unknown_roles(values: Mapping[str, Any]) -> Iterator[tuple[KeyPath, str, str]]:
    """Names of roles that do not exist: where they stand, and what may have been meant."""
    known = {*(role.name.lower() for role in Role if role), *values.get("roles", ())}
    named: list[tuple[KeyPath, list[str]]] = [((name,), values.get(name, [])) for name in _LISTS]
    named += [((name, who), roles) for name in _PEOPLE for who, roles in values.get(name, {}).items()]
    for path, roles in named:
        for index, role in enumerate(roles):
            if role not in known:
                yield ("access", *path, index), f"no role {role!r}", did_you_mean(role, sorted(known))


def impossible(values: Mapping[str, Any]) -> Iterator[tuple[KeyPath, str, str]]:
    """Values of the right form that cannot be: where they stand, and what would be right."""
    for index, address in enumerate(values.get("listen", ())):
        try:
            split_tcp(address)
        except InvalidRequest as error:
            yield ("listen", index), str(error), ""
    for region, said in values.get("scrub", {}).items():
        budget = (said or {}).get("budget", "1%")
        if not 0 < _percent(budget) <= 100:
            yield ("scrub", region, "budget"), f"{budget!r} is no share of the time", "more than 0 %, at most 100 %"


def _percent(said: str) -> float:
    return float(said.rstrip("% "))


SCHEMA = Path(__file__).with_name("settings.schema.json")
_GROUPS = {
    "streams": StreamSettings,
    "dma": DmaSettings,
    "imports": ImportSettings,
    "policy": PolicySettings,
    "record": RecordSettings,
    "limits": LimitSettings,
}
_SECONDS = {"ms": 0.001, "s": 1.0, "min": 60.0, "h": 3600.0}
_PATHS = ("keys", "signers", "runtime_dir", "state_dir")


class SettingsError(SchemaError):
    """A settings file that is not valid; `problems` as in a `SchemaError`."""

    code: ClassVar[str] = "settings_invalid"


class SettingsMissing(CmError):
    """There is no such settings file, or it cannot be read."""

    code: ClassVar[str] = "settings_missing"


def load_settings(path: Path = FILE) -> Settings:
    """The settings in a file. Raises SettingsError with all that is wrong, SettingsMissing."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        problem = Problem(path, 1, 1, "", "yaml_syntax", "not UTF-8 text", "save the file as UTF-8")
        raise SettingsError([problem]) from None
    except OSError as error:
        raise SettingsMissing(f"{path}: {error.strerror}") from None
    return parse_settings(text, path)


def parse_settings(text: str, source: Path | None = None) -> Settings:
    """The settings in `text`; `source` names its file in messages. Raises SettingsError."""
    values = _Reading(source).values(text)
    known: dict[str, Any] = {name: _value(name, values[name]) for name in values}
    assert known.keys() <= set(names(Settings))  # schema and data name the same keys
    return replace(Settings(), **known)


def settings_schema() -> dict[str, Any]:
    """The JSON Schema of the file, for editors and tools."""
    schema: dict[str, Any] = json.loads(SCHEMA.read_text(encoding="utf-8"))
    return schema


def _value(name: str, value: Any) -> Any:
    if name == "access":
        return access(value)
    if name == "scrub":
        return {region: _scrub(said or {}) for region, said in value.items()}
    if name in _GROUPS:
        parts: dict[str, Any] = {key: tuple(part) if isinstance(part, list) else part for key, part in value.items()}
        return _GROUPS[name](**{key: Path(part) if key in _PATHS else part for key, part in parts.items()})
    if name in _PATHS:
        return Path(value)
    return tuple(value) if isinstance(value, list) else value


def _scrub(said: Mapping[str, str]) -> ScrubSettings:
    """``5s`` in seconds, ``2 %`` as a share of at most all."""
    known: dict[str, Any] = dict(said)
    if "every" in said:
        number, unit = re.fullmatch(r"([\d.]+) ?(\w+)", said["every"]).groups()  # type: ignore[union-attr]
        known["every"] = max(0.1, float(number) * _SECONDS[unit])
    if "budget" in said:
        known["budget"] = max(0.0001, _percent(said["budget"]) / 100)
    return ScrubSettings(**known)


class _Reading:
    """One text, and what is wrong with it."""

    def __init__(self, source: Path | None) -> None:
        self._source = source
        self._problems: list[Problem] = []
        self._root: Node = Table(Mark(1, 1))

    def values(self, text: str) -> dict[str, Any]:
        if all(not line.strip() or line.lstrip().startswith("#") for line in text.splitlines()):
            return {}  # only comments, as in the shipped file: all settings have their defaults
        try:
            tree = read(text, self._report_mark)
        except Refused as refused:
            self._report_mark(refused.mark, refused.code, refused.message, refused.hint)
            raise SettingsError(self._problems) from None
        structure = Structure(settings_schema())
        self._root = structure.fit(tree, self._report_at)
        for path, code, message, hint in structure.values(self._root):
            self._report_at(locate(self._root, path), path, code, message, hint)
        found: dict[str, Any] = plain(self._root)
        if not self._problems:
            for path, message, hint in unknown_roles(found.get("access", {})):
                self._report_at(locate(self._root, path), path, "unknown_role", message, hint)
            for path, message, hint in impossible(found):
                self._report_at(locate(self._root, path), path, "value_range", message, hint)
        if self._problems:
            raise SettingsError(sorted(self._problems, key=lambda problem: (problem.line, problem.column)))
        return found

    def _report_mark(self, mark: Mark, code: str, message: str, hint: str) -> None:
        self._report_at(mark, (), code, message, hint)

    def _report_at(self, mark: Mark, path: KeyPath, code: str, message: str, hint: str) -> None:
        self._problems.append(Problem(self._source, mark.line, mark.column, key_path(path), code, message, hint))
