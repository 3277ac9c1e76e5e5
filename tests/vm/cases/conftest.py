# SPDX-License-Identifier: Apache-2.0
"""A test that needs what this board lacks is skipped, or fails where it was promised."""

from __future__ import annotations

import pytest
from capabilities import EXPECTED, LOOK


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", "needs(*capabilities): what the board must have")


def pytest_runtest_setup(item: pytest.Item) -> None:
    for mark in item.iter_markers("needs"):
        for name in mark.args:
            if LOOK[name]():
                continue
            if name in EXPECTED:
                pytest.fail(f"this board was promised to have {name}")
            pytest.skip(f"needs {name}")
