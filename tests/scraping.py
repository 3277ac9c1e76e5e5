# SPDX-License-Identifier: Apache-2.0
"""A scraper of the manager's metrics, by the parser of Prometheus' own client."""

from __future__ import annotations

import json
import threading
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from prometheus_client.parser import text_string_to_metric_families

Labels = frozenset[tuple[str, str]]


@dataclass(frozen=True)
class Scrape:
    """One page, by the samples' names and labels."""

    samples: dict[tuple[str, Labels], float]
    kinds: dict[str, str]

    def value(self, name: str, **labels: str) -> float:
        return self.samples[name, frozenset(labels.items())]

    def by(self, name: str, label: str) -> dict[str, float]:
        """A metric's values by one of its labels."""
        return {dict(labels)[label]: value for (found, labels), value in self.samples.items() if found == name}

    def counters(self) -> dict[tuple[str, Labels], float]:
        """The values that can only grow."""
        parts = ("_total", "_count", "_bucket")
        return {key: value for key, value in self.samples.items() if key[0].endswith(parts)}


def address(runtime: Path) -> str:
    """Where a manager serves its metrics."""
    return str(json.loads((runtime / "endpoints.json").read_text())["metrics"])


def scrape(runtime: Path) -> Scrape:
    with urllib.request.urlopen(f"http://{address(runtime)}/metrics", timeout=60) as reply:
        families = list(text_string_to_metric_families(reply.read().decode()))
    samples = {(s.name, frozenset(s.labels.items())): s.value for family in families for s in family.samples}
    return Scrape(samples, {family.name: family.type for family in families})


@contextmanager
def scraped_meanwhile(runtime: Path, every: float) -> Iterator[list[Scrape]]:
    """Scrape during a block; yields the pages."""
    seen: list[Scrape] = []
    ended = threading.Event()

    def go_on() -> None:
        while not ended.wait(every):
            seen.append(scrape(runtime))

    thread = threading.Thread(target=go_on)
    thread.start()
    try:
        yield seen
    finally:
        ended.set()
        thread.join(60)
