# SPDX-License-Identifier: Apache-2.0
"""Settings of all tests."""

from __future__ import annotations

import functools
import gc
import os
import re

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

# `make -j4 test` and `make -C folder test` set variables for sub-makes; those that tests run are not sub-makes.
for _name in ("MAKEFLAGS", "MAKELEVEL", "MFLAGS"):
    os.environ.pop(_name, None)


def pytest_make_parametrize_id(config: pytest.Config, val: object) -> str | None:
    """Names that can be read and given back: pytest loses some with escaped characters among hundreds of others."""
    if isinstance(val, bytes):
        return f"{len(val)} bytes"
    return re.sub(r"[^ -~]|\\", " ", val[:40]) if isinstance(val, str) else None


def _forget() -> None:
    """mutmut runs the tests in a fork of a process that has run them before: what it cached hides a mutant."""
    for thing in gc.get_objects():
        if isinstance(thing, functools._lru_cache_wrapper) and str(thing.__module__).startswith("cm."):
            thing.cache_clear()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """mutmut names tests one by one, in the order of their times: a module's fixtures are made once all the same."""
    if "MUTANT_UNDER_TEST" in os.environ:
        _forget()
        modules = {path: number for number, path in enumerate(dict.fromkeys(item.path for item in items))}
        items.sort(key=lambda item: modules[item.path])
