# SPDX-License-Identifier: Apache-2.0
"""How long to soak."""

from __future__ import annotations

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--changes", type=int, default=200, help="changes of mode to make")


@pytest.fixture
def changes(request: pytest.FixtureRequest) -> int:
    return int(request.config.getoption("--changes"))
