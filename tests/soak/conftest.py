# SPDX-License-Identifier: Apache-2.0
"""How long to soak."""

from __future__ import annotations

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--changes", type=int, default=200, help="changes of mode to make")
    parser.addoption("--rounds", type=int, default=4, help="rounds of KILL and STOP")
    parser.addoption(
        "--kills", type=int, default=6, help="managers killed while registers are written, and while they do anything"
    )
    parser.addoption("--kill-seed", type=int, default=59, help="of what they are doing then")
    parser.addoption("--upsets", type=int, default=300, help="bits of configuration memory that turn over")
    parser.addoption("--failing", type=int, default=6, help="calls to fail of those that write to the disk; 0: each")
    parser.addoption("--builds", type=int, default=8, help="rounds of designs that are built anew")
    parser.addoption("--stress", type=float, default=5.0, help="seconds for which readers are killed")


@pytest.fixture
def stress_seconds(request: pytest.FixtureRequest) -> float:
    return float(request.config.getoption("--stress"))


@pytest.fixture
def changes(request: pytest.FixtureRequest) -> int:
    return int(request.config.getoption("--changes"))
