# SPDX-License-Identifier: Apache-2.0
"""``cm config check FILE…``: reports what is wrong with runtime schemas, in the manner of compilers."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

from cm.cli.common import print_json
from cm.errors import NotFound
from cm.formats.bitstream.idcodes import DEVICES, base_name, device_by_name
from cm.frozen import dataclass
from cm.schema import Problem, SchemaError, json_schema, load, loads, schema_files
from cm.schema.model import Config, Module
from cm.schema.named_files import FileMissing, bitstream_path
from cm.schema.problems import did_you_mean
from cm.server.settings.loader import SettingsError, SettingsMissing, load_settings, parse_settings, settings_schema
from cm.server.settings.model import FILE as SETTINGS_FILE
from cm.server.settings.model import Settings

_STDIN = Path("-")


@dataclass(frozen=True, slots=True)
class Checked:
    """A file, and its configuration or what is wrong with it."""

    path: Path
    config: Config | None
    problems: tuple[Problem, ...]
    settings: Settings | None = None


def run(args: argparse.Namespace) -> int:
    """Check; 0 if all is good, 1 otherwise."""
    if args.print_schema:
        print_json(settings_schema() if args.settings else json_schema())
        return 0
    if args.settings:
        results = [each for path in args.paths or [SETTINGS_FILE] for each in _readable(path, _check_settings)]
    elif args.paths:
        results = check_files(args.paths)
    else:
        args.usage_error("which FILE?")
    if args.json:
        print_json(_report(results))
    else:
        _print(results)
    return 1 if any(result.problems for result in results) else 0


def check_files(paths: Iterable[Path]) -> list[Checked]:
    """Every file of `paths`, folders opened out; a name that two files of a folder share is a problem."""
    results: list[Checked] = []
    for path in paths:
        results += _readable(path, _check_path)
    return results


def _readable(path: Path, check: Callable[[Path], list[Checked]]) -> list[Checked]:
    """What `check` says; where it may not look there, that is what is wrong with `path`, and others are checked too."""
    try:
        return check(path)
    except OSError as error:
        return [Checked(path, None, (_problem(path, "unreadable", error.strerror or str(error)),))]


def _check_path(path: Path) -> list[Checked]:
    return _check_folder(path) if path.is_dir() else [_check_file(path)]


def _check_file(path: Path) -> Checked:
    try:
        return Checked(path, loads(sys.stdin.read(), "-") if path == _STDIN else load(path), ())
    except SchemaError as error:
        return Checked(path, None, error.problems)
    except NotFound:
        return Checked(path, None, (_problem(path, "not_found", "no such file"),))


def _check_settings(path: Path) -> list[Checked]:
    """Check a settings file, but not the files that it names."""
    try:
        good = parse_settings(sys.stdin.read(), path) if path == _STDIN else load_settings(path)
    except SettingsError as error:
        return [Checked(path, None, error.problems)]
    except SettingsMissing as error:
        return [Checked(path, None, (_problem(path, "not_found", str(error).removeprefix(f"{path}: ")),))]
    if good.listen and not good.keys and not good.insecure:  # what the service refuses, where no option gives keys
        said = "listens on TCP without keys, which the service refuses: 'keys: FILE' ('cm keygen'), or 'insecure: true'"
        return [Checked(path, None, (_problem(path, "insecure_listen", said),))]
    return [Checked(path, None, (), good)]


def _check_folder(folder: Path) -> list[Checked]:
    found: dict[str, Path] = {}
    results = [_apart(_check_file(file), found) for file in schema_files(folder)]
    if not results:
        sentence = "no runtime schema here: no *.yaml or *.yml file with a config:"
        return [Checked(folder, None, (_problem(folder, "not_found", sentence),))]
    return results


def _apart(result: Checked, found: dict[str, Path]) -> Checked:
    """`result`, with a further problem if an earlier configuration has the same name."""
    if result.config is None:
        return result
    first = found.setdefault(result.config.name, result.path)
    if first is result.path:
        return result
    message = f"configuration {result.config.name} is already in {first}"
    return Checked(result.path, result.config, (_problem(result.path, "duplicate_name", message),))


def _problem(path: Path, code: str, message: str) -> Problem:
    return Problem(path, 0, 0, "", code, message)


def _print(results: list[Checked]) -> None:
    for result in results:
        for problem in result.problems:
            print(problem)
        if result.config is not None and not result.problems:
            name, count = result.config.name, len(result.config.modes)
            print(f"{result.path}: good: configuration {name}, {count} mode{'s' * (count != 1)}")
            for note in (*_unknown_device(result.config), *_missing(result.config)):
                print(f"{result.path}: note: {note}")
        if result.settings is not None:
            print(f"{result.path}: good: settings")


def _unknown_device(config: Config) -> Iterator[str]:
    """What says that a device is not known here, so that its bitstreams are compared by the name in them alone."""
    if config.device and config.idcode is None and device_by_name(config.device) is None:
        hint = did_you_mean(base_name(config.device), [device.name for device in DEVICES])
        yield f"device: the IDCODE of {config.device} is not known ({hint}); idcode: gives that of another device"


def _missing(config: Config) -> Iterator[str]:
    """What says that a bitstream which the schema names is nowhere here; it may be where the board is."""
    whole: list[Module | None] = [None] if config.bitstream else []
    for module in (*whole, *(module for module in config.modules.values() if module.bitstream)):
        try:
            bitstream_path(config, module)
        except FileMissing as error:
            yield str(error)


def _report(results: list[Checked]) -> dict[str, Any]:
    keys = ("line", "column", "key", "code", "message", "hint")
    files = [
        {
            "path": str(result.path),
            "good": not result.problems,
            "config_name": result.config.name if result.config else None,
            "problems": [{key: getattr(problem, key) for key in keys} for problem in result.problems],
        }
        for result in results
    ]
    return {"good": all(file["good"] for file in files), "files": files}
