# SPDX-License-Identifier: Apache-2.0
"""The whole page of metrics of a daemon in a known state: the names, labels and help that dashboards depend on."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from daemon_thread import daemon
from prometheus_client.parser import text_string_to_metric_families

from cm.cli.main import main
from cm.manager.status_reports import ChangeTotals
from cm.server.metrics import Metrics
from cm.server.streams.stream import Moved
from cm.wire.messages.status import (
    ClientStatus,
    ClockStatus,
    LeaseStatus,
    PrMode,
    RegionHealth,
    RegionStatus,
    SensorStatus,
    Status,
    StreamClient,
    StreamStatus,
)

PAGE = Path(__file__).parents[2] / "golden/metrics/page.txt"
READER = StreamClient(7, "view", depth=3)
STATUS = Status(
    "camera", "edges", True, PrMode.ERROR, sequence=42, version="1.2", started_ns=1_500_000_000, board="lab",
    last_change=9, last_change_seconds=0.25, clocks=(ClockStatus("fclk0", 100, 99), ClockStatus("off", 100)),
    regions=(
        RegionStatus("prr0", "edge", "ready", health=RegionHealth(checks=7, upsets=3, repairs=2, wrong_bits=1)),
        RegionStatus("prr1", None, "unknown"),
    ),
    streams=(
        StreamStatus("camera", "dma0", "s2mm", slots=8, open=True, frames=5, rate=30.5, latency_us=250.0,
                     clients=(READER,), overruns=2),
        StreamStatus("to_pl", "dma1", "mm2s", slots=4),
    ),
    sensors=(
        SensorStatus("xadc", "temp0", "temperature", 41.5), SensorStatus("xadc", "vccint", "voltage", 0.85),
        SensorStatus("ina226", "curr1", "current", 0.4), SensorStatus("ina226", "power1", "power", 4.9),
    ),
    leases=(
        LeaseStatus(1, "registers:led", client="pid 7 (view)"),
        LeaseStatus(2, "board", exclusive=False, client="key robot"),
    ),
)  # fmt: skip


def totals() -> ChangeTotals:
    """Totals of two successful changes, a failed one, and the time of a port's loads."""
    made = ChangeTotals()
    made.ended(None, 0.02)
    made.ended(None, 0.5)
    made.ended("load_failed", 1.0)
    made.took("load", 0.25)
    made.loaded("icap", 1000, 0.125)
    return made


def metrics(loop: Any) -> Metrics:
    clients = [ClientStatus("pid 7 (view)", 2, upload_bytes=11, waiting_bytes=12, requests=5, waiting=3)]
    services: Any = SimpleNamespace(
        loop=loop,
        status=lambda: STATUS,
        manager=SimpleNamespace(
            totals=totals(), leases=SimpleNamespace(held=lambda: STATUS.leases, statuses=lambda: STATUS.leases)
        ),
        streams=SimpleNamespace(
            moved=lambda: {"camera": Moved(50, 1, 2, 4000), "gone": Moved(frames=6)},
            status=lambda: STATUS.streams,
            allocated=Counter,
        ),
        connections=SimpleNamespace(counted=Counter),
        clients=SimpleNamespace(statuses=lambda _: clients),
        interrupts=SimpleNamespace(counts={"done": 17}),
    )
    requests: Any = SimpleNamespace(taken=33, refused=Counter({"busy": 4}))
    return Metrics(services, requests)


@pytest.fixture
def page() -> Any:
    return metrics(SimpleNamespace(ask=lambda call: call())).page().decode()


def families(text: str) -> list[Any]:
    """Names, kinds, help and samples, except for what a process uses, which differs from run to run."""
    return [
        (
            f.name,
            f.type,
            f.documentation,
            {(s.name, *sorted(s.labels.items())): s.value for s in f.samples if s.name[:4] != "proc"},
        )
        for f in text_string_to_metric_families(text)
    ]


def test_the_page_is_what_dashboards_know(page: str) -> None:
    known = families(PAGE.read_text(encoding="utf-8"))
    assert families(page) == known, "look at the difference, then write the page anew"


def test_every_metric_is_documented_with_its_kind(page: str) -> None:
    rows = (Path(__file__).resolve().parents[3] / "docs/metrics.md").read_text(encoding="utf-8").splitlines()
    said: dict[str, str] = {}
    for row in rows:
        if row.startswith("| `"):
            named, kind = row.split("|")[1:3]
            said |= dict.fromkeys(re.findall(r"`(\w+)`", named), kind.strip())
    for family in text_string_to_metric_families(page):
        full = f"{family.name}_total" if family.type == "counter" else family.name
        assert full in said, full
        assert said[full] in (family.type, ""), (full, family.type)
        assert family.documentation[:1].isupper() or family.documentation[:2] == "1 ", (full, family.documentation)
        assert family.documentation.endswith("."), (full, family.documentation)


def test_what_the_process_uses_is_what_the_kernel_says(page: str) -> None:
    (cpu, memory, descriptors) = [
        s.value for f in text_string_to_metric_families(page) for s in f.samples if s.name[:4] == "proc"
    ]
    assert time.process_time() - 10 < cpu <= time.process_time()
    resident = int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    assert memory == pytest.approx(resident, rel=0.2)
    assert abs(descriptors - len(list(Path("/proc/self/fd").iterdir()))) < 4


def test_how_late_the_loop_is_is_measured_again_and_again(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    now, timers = [10.0], list[Any]()
    monkeypatch.setattr("cm.server.metrics.time", SimpleNamespace(monotonic=lambda: now[0], process_time=lambda: 0.0))
    caplog.set_level("INFO", "cm")
    made = metrics(SimpleNamespace(ask=lambda call: call(), call_at=lambda *timer: timers.append(timer)))
    where = made.open("0")
    assert caplog.messages == [f"metrics at http://{where}/metrics"]
    for late in (0.03, -0.01, 0.04):
        due, call = timers.pop()
        assert due == pytest.approx(now[0] + 0.1)
        now[0] = due + late
        call()
    found = {
        (s.name.rpartition("_")[2], s.labels.get("le")): s.value
        for f in text_string_to_metric_families(made.page().decode())
        for s in f.samples
        if f.name == "cm_loop_lag_seconds"
    }
    assert [found["bucket", le] for le in ("0.02", "0.05", "+Inf")] == [1, 3, 3]
    assert found["sum", None] == pytest.approx(0.07)
    made.close()
    made.close()


# ---- without metrics, or without their library --------------------------------------------


def test_a_manager_without_metrics_imports_neither_their_library_nor_an_http_server() -> None:
    code = "import sys, cm.server.server\nprint([n for n in ('prometheus_client', 'http.server') if n in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"


def test_a_board_whose_settings_ask_for_metrics_is_served_without_the_library(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setitem(sys.modules, "prometheus_client", None)
    monkeypatch.delitem(sys.modules, "cm.server.metrics")
    with daemon(metrics="0") as made:
        made.load("default")
        assert "metrics" not in json.loads((made.folder / "run" / "endpoints.json").read_text())
    assert "no metrics are served: they need prometheus-client: pip install prometheus-client" in caplog.text


def test_the_command_that_asks_for_metrics_is_refused_without_the_library(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setitem(sys.modules, "prometheus_client", None)
    assert main(["serve", "--metrics", "0", "--runtime-dir", str(tmp_path), "--root", str(tmp_path)]) == 1
    assert "--metrics: they need prometheus-client: pip install prometheus-client" in capsys.readouterr().err
