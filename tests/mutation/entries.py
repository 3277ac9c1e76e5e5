# SPDX-License-Identifier: Apache-2.0
"""A plugin of pytest, for `sample.py`: which test enters which line, and a run of chosen tests only.

Under `coverage run` it names the test at work as coverage's context, and writes the times to $CM_TEST_TIMES. What is
run while fixtures are made is put down to all tests of the file, as a later one may use what the first has made.
$CM_TESTS names a file of the tests, or files of tests, to run: names on a command line lose escaped characters.
"""

from __future__ import annotations

import functools
import gc
import json
import os
import sys
from collections import defaultdict
from pathlib import Path

import coverage
import pytest


def _caches() -> list[functools._lru_cache_wrapper[object]]:
    wrappers = [thing for thing in gc.get_objects() if isinstance(thing, functools._lru_cache_wrapper)]
    return [cache for cache in wrappers if str(cache.__module__).startswith("cm.")]


def file_of(item: pytest.Item) -> str:
    return item.nodeid.partition("::")[0]


class Recorder:
    """Before each test all caches of cm are emptied: what an earlier test has cached hides what this one enters."""

    def __init__(self, measured: coverage.Coverage, times: Path) -> None:
        self.measured, self.path = measured, times
        self.times: defaultdict[str, float] = defaultdict(float)
        self.modules = 0
        self.caches: list[functools._lru_cache_wrapper[object]] = []

    def pytest_runtest_setup(self, item: pytest.Item) -> None:
        if len(sys.modules) != self.modules:
            self.modules, self.caches = len(sys.modules), _caches()
        for cache in self.caches:
            cache.cache_clear()
        self.measured.switch_context(file_of(item))

    def pytest_runtest_call(self, item: pytest.Item) -> None:
        self.measured.switch_context(item.nodeid)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self.times[report.nodeid] += report.duration

    def pytest_sessionfinish(self) -> None:
        self.path.write_text(json.dumps(self.times), encoding="utf-8")


def pytest_configure(config: pytest.Config) -> None:
    measured = coverage.Coverage.current()
    if measured is not None:
        config.pluginmanager.register(Recorder(measured, Path(os.environ["CM_TEST_TIMES"])))


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    if "CM_TESTS" in os.environ:
        chosen = set(json.loads(Path(os.environ["CM_TESTS"]).read_text(encoding="utf-8")))
        items[:] = [item for item in items if item.nodeid in chosen or file_of(item) in chosen]
