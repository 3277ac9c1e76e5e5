# SPDX-License-Identifier: Apache-2.0
"""Options of the fleet's rounds."""

from __future__ import annotations

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("fleet")
    group.addoption("--fleet-rounds", type=int, default=8, help="rounds, in each of which something dies")
    group.addoption("--stopped", type=float, default=4.0, help="seconds for which something stopped or cut off is so")
    group.addoption("--seed", type=int, default=1, help="of what is drawn")


@pytest.fixture
def in_long(request: pytest.FixtureRequest) -> bool:
    """As `make soak-fleet`, and not as CI, has time for it."""
    return bool(request.config.getoption("--fleet-rounds") >= 100)
