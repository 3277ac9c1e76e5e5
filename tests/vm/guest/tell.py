# SPDX-License-Identifier: Apache-2.0
"""A pytest plugin: tells a failure when it happens, since the board may not live to the end of the run."""

from __future__ import annotations

import pytest


class _Tell:
    def __init__(self, config: pytest.Config) -> None:
        self._config = config

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        terminal = self._config.pluginmanager.get_plugin("terminalreporter")
        if report.failed and terminal is not None:
            terminal.write_line(f"\n{report.nodeid} ({report.when}):\n{report.longreprtext}")
            terminal.flush()


def pytest_configure(config: pytest.Config) -> None:
    config.pluginmanager.register(_Tell(config), "tell-failures")
