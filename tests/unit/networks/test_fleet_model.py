# SPDX-License-Identifier: Apache-2.0
"""The model of large fleets: it scales as expected, and says what breaks first."""

from __future__ import annotations

from cm.tools.bench.fleet_model import SIZES, Measured, reckoned

SMALL = Measured(50, 0.05, 500.0, 1e-3, 5e-4, 2e-3)


def test_bytes_and_processor_time_grow_with_the_number_of_boards() -> None:
    rows = [reckoned(SMALL, boards) for boards in SIZES]
    assert [row["status_bytes_per_second"] for row in rows] == [boards * 500.0 for boards in SIZES]
    assert [row["client_cpus"] for row in rows] == [boards * 1e-3 for boards in SIZES]
    assert [row["change_client_seconds"] for row in rows] == [boards * 2e-3 for boards in SIZES]


def test_what_breaks_first_is_named() -> None:
    assert reckoned(SMALL, 50)["first"] == "nothing"
    assert reckoned(SMALL, 10_000)["first"] == "the client's processor"
    quick = Measured(50, 0.05, 500.0, 1e-6, 5e-7, 2e-6)
    assert reckoned(quick, 10_000)["first"] == "discovery at one router"
