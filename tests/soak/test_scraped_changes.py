# SPDX-License-Identifier: Apache-2.0
"""Changes of mode, scraped every tenth of a second: the metrics agree with cm_status."""

from __future__ import annotations

from itertools import cycle, islice, pairwise

import pytest
from manager_process import served
from scraping import scrape, scraped_meanwhile

MODES = ("edge_detection", "colorise", "default")


@pytest.mark.timeout(3600)
def test_the_metrics_of_many_changes_are_those_of_the_status(changes: int) -> None:
    with (
        served(board=["--icap-rate", "0"], arguments=["--metrics", "0"]) as (manager, _),
        manager.connected() as board,
    ):
        seconds = [board.load("camera", "default")]
        with scraped_meanwhile(manager.runtime, 0.1) as seen:
            for mode in islice(cycle(MODES), changes):
                seconds.append(board.load(mode=mode))
        sequence, last, status = board.status.sequence, scrape(manager.runtime), board.status
    for before, after in pairwise([*seen, last]):
        assert all(after.samples[key] >= value for key, value in before.counters().items())
    for at in (*seen, last):  # each page is of one moment
        assert at.value("cm_change_seconds_count") == sum(at.by("cm_changes_total", "outcome").values())
    assert last.by("cm_changes_total", "outcome") == {"done": changes + 1, "failed": 0, "cancelled": 0}
    assert last.value("cm_last_change") == status.last_change == changes + 1
    assert last.value("cm_last_change_seconds") == status.last_change_seconds
    assert last.value("cm_change_seconds_sum") == pytest.approx(sum(seconds), abs=0.01)
    assert last.value("cm_change_step_seconds_count", step="load") == last.value("cm_loads_total", port="icap")
    assert sequence <= last.value("cm_status_sequence") <= status.sequence
    assert last.value("cm_mode", config=status.config_name, mode=status.mode) == 1
    assert sum(last.by("cm_change_step_seconds_sum", "step").values()) <= last.value("cm_change_seconds_sum")
    print(f"{changes} changes, {len(seen)} scrapes meanwhile")
