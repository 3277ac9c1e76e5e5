# SPDX-License-Identifier: Apache-2.0
"""The metrics of `cm serve --metrics`, from manager, streams and the loop; docs/metrics.md lists them.

Imported only where metrics are asked for. prometheus-client writes the text; its own server has no bounds, so
`cm.server.metrics_server` hands it out.
"""

from __future__ import annotations

import logging
import os
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path

from prometheus_client import generate_latest
from prometheus_client.core import (
    CollectorRegistry,
    HistogramMetricFamily,
    Metric,
    SummaryMetricFamily,
)

from cm.manager.status_reports import ChangeCounts, Distribution, Histogram, Times
from cm.server.client_quotas import with_holdings
from cm.server.dispatcher import Dispatcher
from cm.server.metrics_server import MetricsServer
from cm.server.request_handlers import Services
from cm.server.streams.stream import Moved
from cm.wire.messages.status import SensorStatus, Status, StreamStatus

_LOG = logging.getLogger("cm")
_LAG_EVERY = 0.1  # seconds between two measurements of how late the loop's timers are
_LAG_SECONDS = (0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 5.0)
_UNITS = {"temperature": "celsius", "voltage": "volts", "current": "amperes", "power": "watts"}

_MOVED = {
    "frames": "Frames that came, or were taken, since the manager's start.",
    "bytes": "Bytes of these frames, since the manager's start.",
    "dropped": "Frames times local readers that did not get them, since the manager's start.",
    "errors": "Transfers that failed, since the manager's start.",
}
_STREAM: dict[str, tuple[str, Callable[[StreamStatus], float]]] = {
    "open": ("Whether it runs.", lambda s: s.open),
    "frames": ("Frames since it was opened, as cm_status has them.", lambda s: s.frames),
    "rate": ("Frames per second, over the last second.", lambda s: s.rate),
    "latency_seconds": (
        "From a frame's completion until every client had it, median of the last 64.", lambda s: s.latency_us / 1e6,
    ),
    "clients": ("Clients on the manager's machine.", lambda s: len(s.clients)),
    "slots": ("Frame buffers.", lambda s: s.slots),
}  # fmt: skip
_CLIENT = {
    "connections": "Connections over ZeroMQ.",
    "waiting_bytes": "Bytes of requests that wait, and of replies that were not read.",
    "unread_bytes": "Bytes of replies that were not read.",
    "upload_bytes": "Bytes sent in parts and not used yet.",
    "waiting": "Requests under way that take long.",
    "memory_bytes": "Bytes of memory for masters in the PL.",
    "leases": "Leases that it holds.",
    "slots": "Slots of streams that it may hold.",
    "requests": "Its requests.",
}
_HEALTH = {
    "checks_total": ("checks", "counter", "Checks of what a region holds."),
    "upsets_total": ("upsets", "counter", "Bits that were found wrong."),
    "repairs_total": ("repairs", "counter", "Repairs of regions."),
    "wrong_bits": ("wrong_bits", "gauge", "Bits that are wrong, by the last check."),
}
_LOADS = {
    "cm_loads_total": ("number", "Images that went through a port."),
    "cm_loaded_bytes_total": ("bytes", "Their bytes."),
    "cm_load_seconds_total": ("seconds", "The port's time for them."),
}


class _Page(CollectorRegistry):
    """What was collected, as a registry."""

    def __init__(self, families: list[Metric]) -> None:
        super().__init__()
        self._families = families

    def collect(self) -> Iterator[Metric]:
        """All of it."""
        return iter(self._families)


class Metrics:
    """Serves them from `open` on. The loop's thread, but for `page`."""

    def __init__(self, services: Services, requests: Dispatcher) -> None:
        self._s = services
        self._requests = requests
        self._lag = Histogram(_LAG_SECONDS)
        self._due = 0.0
        self._server = MetricsServer(self.page)

    def open(self, address: str) -> str:
        """Listen; returns where. Raises InvalidRequest."""
        bound = self._server.open(address)
        _LOG.info("metrics at http://%s/metrics", bound)
        self._wait()
        return bound

    def close(self) -> None:
        """Serve no more."""
        self._server.close()

    def page(self) -> bytes:
        """The text, as it is now; any thread. Raises TimeoutError if the loop does not answer."""
        return generate_latest(_Page(self._s.loop.ask(self._families)))

    def _families(self) -> list[Metric]:
        """What there is at one moment; the loop's thread."""
        status = self._s.status()
        families = [
            *_of_board(status),
            *_of_changes(status, self._s.manager.totals.read()),
            *self._of_streams(status),
            *_of_sensors(status.sensors),
            *self._of_requests(),
            *self._of_process(),
        ]
        return [family for family in families if family.samples]

    def _wait(self) -> None:
        self._due = time.monotonic() + _LAG_EVERY
        self._s.loop.call_at(self._due, self._late)

    def _late(self) -> None:
        """Note how late this call is: a client that asks now has to wait that long for the loop."""
        self._lag.add(max(0.0, time.monotonic() - self._due))
        self._wait()

    def _of_streams(self, status: Status) -> Iterator[Metric]:
        told = {s.name: s for s in status.streams}
        moved = {**dict.fromkeys(told, Moved()), **self._s.streams.moved()}
        for name, text in _MOVED.items():
            counts = {stream: getattr(m, name) for stream, m in moved.items()}
            yield by_label(f"cm_stream_{name}_total", "counter", text, "stream", counts)
        overruns = {stream: s.overruns for stream, s in told.items()}
        text = "Times that a subscriber over ZeroMQ began to lose frames, since the manager's start."
        yield by_label("cm_stream_overruns_total", "counter", text, "stream", overruns)
        for name, (text, value) in _STREAM.items():
            values = {stream: float(value(s)) for stream, s in told.items()}
            yield by_label(f"cm_stream_{name}", "gauge", text, "stream", values)

    def _of_requests(self) -> Iterator[Metric]:
        requests = self._requests
        yield single("cm_requests_total", "counter", "Requests of clients.", requests.taken)
        yield by_label(
            "cm_request_errors_total", "counter", "Refused ones, by the error's code.", "code", requests.refused
        )
        held = Counter(
            (lease.scope.partition(":")[0], "alone" if lease.exclusive else "shared")
            for lease in self._s.manager.leases.held()
        )
        kinds = [({"scope": scope, "how": how}, float(count)) for (scope, how), count in sorted(held.items())]
        yield single("cm_leases", "gauge", "Leases that are held.", held.total())
        yield many("cm_leases_by_scope", "gauge", "The same, by what they cover.", kinds)
        held_by = self._s.manager.leases.statuses(), self._s.streams.status(), self._s.streams.allocated()
        told = self._s.clients.statuses(self._s.connections.counted())
        clients = {client.name: client for client in with_holdings(told, *held_by)}
        for name, text in _CLIENT.items():
            values = {client: getattr(c, name) for client, c in clients.items()}
            yield by_label(f"cm_client_{name}", "gauge", text, "client", values)
        counts = self._s.interrupts.counts
        yield by_label(
            "cm_interrupts_total", "counter", "Interrupts since the configuration was loaded.", "interrupt", counts
        )

    def _of_process(self) -> Iterator[Metric]:
        yield histogram(
            "cm_loop_lag_seconds", "How late the daemon's loop was, asked ten times a second.", self._lag.read()
        )
        yield single("cm_scrapes_total", "counter", "Replies with this page.", self._server.scrapes)
        pages = int(Path("/proc/self/statm").read_text("ascii").split()[1])
        yield single("process_cpu_seconds_total", "counter", "Processor time of the manager.", time.process_time())
        resident = pages * os.sysconf("SC_PAGE_SIZE")
        yield single("process_resident_memory_bytes", "gauge", "Its resident memory.", resident)
        yield single("process_open_fds", "gauge", "Its descriptors.", len(os.listdir("/proc/self/fd")))  # noqa: PTH208


def _of_board(status: Status) -> Iterator[Metric]:
    about = {"version": status.version, "board": status.board}
    yield many("cm_info", "gauge", "The manager's version and the board's name.", [(about, 1)])
    yield single("cm_start_time_seconds", "gauge", "When the manager started (Unix time).", status.started_ns / 1e9)
    yield single("cm_status_sequence", "gauge", "Number of the last published status.", status.sequence)
    loaded = {"config": status.config_name, "mode": status.mode}
    yield many("cm_mode", "gauge", "1 for the configuration and mode that are loaded.", [(loaded, 1)])
    yield single("cm_busy", "gauge", "Whether a change runs.", status.fpga_busy)
    yield single("cm_failed", "gauge", "Whether the last change failed.", status.pr_mode.value == "error")
    regions = [({"region": r.name, "module": r.module or "", "state": r.state}, 1) for r in status.regions]
    yield many("cm_region", "gauge", "1 for what each region holds and its state.", regions)
    health = {region.name: region.health for region in status.regions if region.health is not None}
    for name, (field, kind, text) in _HEALTH.items():
        found = {region: getattr(h, field) for region, h in health.items()}
        yield by_label(f"cm_region_{name}", kind, text, "region", found)
    rates = {c.name: float(c.rate) for c in status.clocks if c.rate}
    yield by_label("cm_clock_hertz", "gauge", "Clocks of the loaded configuration.", "clock", rates)


def _of_changes(status: Status, counts: ChangeCounts) -> Iterator[Metric]:
    outcomes = {name: counts.outcomes.get(name, 0) for name in ("done", "failed", "cancelled")}
    yield by_label("cm_changes_total", "counter", "Changes of mode, by how they ended.", "outcome", outcomes)
    failures = dict(counts.failures)
    yield by_label("cm_change_failures_total", "counter", "Those that did not end well, by code.", "code", failures)
    yield histogram("cm_change_seconds", "How long changes took.", counts.seconds)
    yield times("cm_change_step_seconds", "How long the steps of changes took.", "step", counts.steps)
    yield single("cm_last_change", "gauge", "Number of the last change that ended.", status.last_change)
    yield single("cm_last_change_seconds", "gauge", "How long it took.", status.last_change_seconds)
    loads = counts.loads
    for name, (field, text) in _LOADS.items():
        yield by_label(name, "counter", text, "port", {port: getattr(x, field) for port, x in loads.items()})


def _of_sensors(sensors: tuple[SensorStatus, ...]) -> Iterator[Metric]:
    for quantity, unit in _UNITS.items():
        found = {(s.device, s.name): s.value for s in sensors if s.quantity == quantity}
        samples = [({"device": device, "sensor": name}, value) for (device, name), value in found.items()]
        yield many(f"cm_{quantity}_{unit}", "gauge", f"What the board's sensors say, in {unit}.", samples)


# ---- families -------------------------------------------------------------------


def single(name: str, kind: str, help_text: str, value: float) -> Metric:
    """A metric of one value."""
    return many(name, kind, help_text, [({}, value)])


def by_label(name: str, kind: str, help_text: str, label: str, values: Mapping[str, float]) -> Metric:
    """A metric of one label."""
    return many(name, kind, help_text, [({label: key}, values[key]) for key in sorted(values)])


def many(name: str, kind: str, help_text: str, samples: Iterable[tuple[Mapping[str, str], float]]) -> Metric:
    """A metric of several labels."""
    family = Metric(name.removesuffix("_total"), help_text, kind)
    for labels, value in samples:
        family.add_sample(name, dict(labels), value)
    return family


def histogram(name: str, help_text: str, found: Distribution) -> Metric:
    """A distribution."""
    bounds = (*(f"{bound:g}" for bound in found.bounds), "+Inf")
    return HistogramMetricFamily(
        name, help_text, buckets=list(zip(bounds, found.at_most, strict=True)), sum_value=found.sum
    )


def times(name: str, help_text: str, label: str, found: Mapping[str, Times]) -> Metric:
    """Seconds by label, as a summary without quantiles."""
    family = SummaryMetricFamily(name, help_text, labels=[label])
    for key in sorted(found):
        family.add_metric([key], count_value=found[key].number, sum_value=found[key].seconds)
    return family
