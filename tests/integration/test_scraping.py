# SPDX-License-Identifier: Apache-2.0
"""``cm serve --metrics`` and the board's sensors in the status, over the processes that users run."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import ExitStack
from itertools import islice
from pathlib import Path

import pytest
from manager_process import Manager, served, until
from scraping import address, scrape

from cm.cli.main import main
from cm.simulation.software import Board as SimBoard

FRAME = 480 * 640


@pytest.fixture(scope="module")
def scraped() -> Iterator[tuple[Manager, SimBoard]]:
    with served(arguments=["--metrics", "0"]) as both:
        with both[0].connected() as board:
            board.load("camera", "default")
        yield both


def test_every_family_has_a_kind_and_the_manager_is_named(scraped: tuple[Manager, SimBoard]) -> None:
    page = scrape(scraped[0].runtime)
    assert set(page.kinds.values()) == {"gauge", "counter", "histogram", "summary"}
    with scraped[0].connected() as board:
        status = board.status
    assert page.value("cm_info", version=status.version, board=status.board) == 1
    assert page.value("cm_start_time_seconds") == pytest.approx(status.started_ns / 1e9)
    assert page.by("cm_region", "region").keys() == {region.name for region in status.regions}
    assert page.value("process_resident_memory_bytes") > 1 << 20


def test_frames_and_bytes_are_those_of_the_status_and_outlive_the_stream(scraped: tuple[Manager, SimBoard]) -> None:
    manager = scraped[0]
    before = scrape(manager.runtime).by("cm_stream_frames_total", "stream")["camera"]
    with manager.connected() as board:
        with board.stream("camera", timeout=60) as stream:
            for _ in islice(stream, 5):
                pass
            least = next(s.frames for s in board.status.streams if s.name == "camera")
            page = scrape(manager.runtime)
            most = next(s.frames for s in board.status.streams if s.name == "camera")
        assert 5 <= least <= page.value("cm_stream_frames", stream="camera") <= most
        assert page.value("cm_stream_bytes_total", stream="camera") == FRAME * page.value(
            "cm_stream_frames_total", stream="camera"
        )
        until(lambda: not any(s.open for s in board.status.streams))
    after = scrape(manager.runtime)
    assert after.value("cm_stream_frames", stream="camera") == 0
    assert after.value("cm_stream_frames_total", stream="camera") >= before + least


def test_what_the_sensors_say_is_in_status_metrics_and_the_command(
    scraped: tuple[Manager, SimBoard], capsys: pytest.CaptureFixture[str]
) -> None:
    manager, sim = scraped
    folder = Path(sim.root, "sys/bus/iio/devices/iio:device0")
    (folder / "in_temp0_raw").write_text("2900\n")
    expected = (2900 - 2219) * 123.040771484 / 1000
    with manager.connected() as board:
        until(lambda: any(s.value == pytest.approx(expected) for s in board.status.sensors))
        assert {s.quantity for s in board.status.sensors} == {"temperature", "voltage", "current", "power"}
    page = scrape(manager.runtime)
    assert page.value("cm_temperature_celsius", device="xadc", sensor="temp0") == pytest.approx(expected)
    assert main(["status", "--runtime-dir", str(manager.runtime)]) == 0
    assert f"temp0 {expected:.1f} °C" in capsys.readouterr().out


def test_scrapers_that_ask_and_do_not_read_keep_no_client_from_its_answer(scraped: tuple[Manager, SimBoard]) -> None:
    manager = scraped[0]
    host, port = address(manager.runtime).rsplit(":", 1)
    with manager.connected() as board, ExitStack() as stack:
        for number in range(200):
            sock = stack.enter_context(socket.create_connection((host, int(port)), 60))
            sock.sendall(b"GET /metrics HTTP/1.1\r\nHost: x\r\n" + (b"\r\n" if number % 2 else b""))
            assert board.status.config_name == "camera"
        assert scrape(manager.runtime).value("cm_leases") == 0
