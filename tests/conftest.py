# SPDX-License-Identifier: Apache-2.0
"""Settings of all tests."""

from __future__ import annotations

import os
import re
from collections.abc import Generator
from pathlib import Path
from typing import TypeVar

import pytest
from hypothesis import HealthCheck, Phase, settings

# A busy machine must not fail a test: no deadlines. The explain phase costs much and tells little here.
# The examples are the same in every run; --hypothesis-profile=search draws others, as make soak does.
settings.register_profile(
    "search",
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow],
    phases=[Phase.explicit, Phase.reuse, Phase.generate, Phase.shrink],
)
settings.register_profile("cm", settings.get_profile("search"), derandomize=True)
settings.load_profile("cm")

# Nor must simulators that get no processor time; tests of silent ones set their own limit (seconds).
os.environ.setdefault("CM_SIM_TIMEOUT", "60")

# Tests start many processes: byte code is kept for them, elsewhere where none is wanted beside the sources.
if os.environ.pop("PYTHONDONTWRITEBYTECODE", None):
    os.environ.setdefault("PYTHONPYCACHEPREFIX", str(Path(__file__).parents[1] / "build/pycache"))

# `make -j4 test` and `make -C folder test` set variables for sub-makes; those that tests run are not sub-makes.
for _name in ("MAKEFLAGS", "MAKELEVEL", "MFLAGS"):
    os.environ.pop(_name, None)


# What `make test` leaves to further targets, as README's packages do not suffice: the tests in folders of these names,
# and those with a marker (pyproject.toml says what each needs).
SUITES = ("design", "networks", "web", "programs", "release", "open", "soak", "elsewhere")
OF_ALL = re.compile(rf"^pytestmark = \[?\s*pytest\.mark\.({'|'.join(SUITES)})\b", re.MULTILINE)
HERE = Path(__file__).parent


Report = TypeVar("Report", pytest.TestReport, pytest.CollectReport)


def pytest_make_parametrize_id(config: pytest.Config, val: object) -> str | None:
    """Names that can be read and given back: pytest loses some with escaped characters among hundreds of others."""
    if isinstance(val, bytes):
        return f"{len(val)} bytes"
    return re.sub(r"[^ -~]|\\", " ", val[:40]) if isinstance(val, str) else None


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--suite", help="only the tests with this marker of pyproject.toml; 'plain': those with none")
    parser.addoption(
        "--no-skips", action="store_true", help="a test that is skipped has failed: all it needs should be here"
    )


def _folder(path: Path) -> str:
    return next((part for part in path.relative_to(HERE).parts if part in SUITES), "plain")


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """A file all of whose tests belong to another suite is not even imported: what it imports may be absent."""
    suite = config.getoption("suite")
    if suite is None or collection_path.suffix != ".py" or not collection_path.is_relative_to(HERE):
        return None
    text = collection_path.read_text(encoding="utf-8")
    of_all = OF_ALL.search(text)
    of_file = of_all[1] if of_all else _folder(collection_path)
    return None if suite == of_file or f"pytest.mark.{suite}" in text else True


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    return _no_skip(item.config, (yield))


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(
    collector: pytest.Collector,
) -> Generator[None, pytest.CollectReport, pytest.CollectReport]:
    return _no_skip(collector.config, (yield))


def _no_skip(config: pytest.Config, report: Report) -> Report:
    if report.skipped and config.getoption("no_skips") and not hasattr(report, "wasxfail"):
        report.outcome = "failed"
        report.longrepr = f"skipped, with --no-skips: {report.longrepr}"
    return report


def _suite(item: pytest.Item) -> str:
    return next((mark.name for mark in item.iter_markers() if mark.name in SUITES), _folder(item.path))


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave those of other suites."""
    if suite := config.getoption("suite"):
        items[:] = [item for item in items if _suite(item) == suite]
