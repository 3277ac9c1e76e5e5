# SPDX-License-Identifier: Apache-2.0
"""What a scraper of the metrics costs the manager."""

from __future__ import annotations

import json
import statistics
import time
import urllib.request
from collections.abc import Callable

from cm.tools.bench.result import Goal, Result
from cm.tools.bench.run import Run
from cm.tools.bench.serving import PATIENCE, cpu_percent, serve, settle

EVERY = 0.1  # seconds; Prometheus' own default is 60
GOAL = Goal(2.0)
RAN = (
    "processor time of the process of cm serve when it has nothing to do, scraped ten times a second, less what it "
    "uses without a scraper (but with its metrics on); percent of one CPU"
)


def run(bench: Run) -> list[Result]:
    """Measure `scraping`."""
    rounds, seconds = (1, 0.5) if bench.quick else (3, 5.0)
    with serve(bench, "--metrics", "0") as served, served.connect() as board:
        settle(board)
        address = json.loads((served.runtime_dir / "endpoints.json").read_text(encoding="utf-8"))["metrics"]
        sizes: list[int] = []

        def scrape() -> None:
            with urllib.request.urlopen(f"http://{address}/metrics", timeout=PATIENCE) as reply:
                sizes.append(len(reply.read()))

        scrape()
        quiet, scraped = [], []
        for _ in range(rounds):
            quiet.append(cpu_percent(served.pid, lambda: _ten_times_a_second(seconds, lambda: None)))
            scraped.append(cpu_percent(served.pid, lambda: _ten_times_a_second(seconds, scrape)))
    details = {
        "percent_while_scraped": statistics.median(scraped),
        "percent_without": statistics.median(quiet),
        "scrapes": len(sizes),
        "bytes_of_a_page": sizes[-1],
    }
    value = statistics.median(scraped) - statistics.median(quiet)
    return [Result("scraping", value, "% of a CPU", RAN, goal=GOAL, details=details)]


def _ten_times_a_second(seconds: float, do: Callable[[], None]) -> None:
    started = time.monotonic()
    while (due := EVERY - (time.monotonic() - started) % EVERY) and time.monotonic() < started + seconds:
        time.sleep(due)
        do()
