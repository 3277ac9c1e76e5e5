# SPDX-License-Identifier: Apache-2.0
"""``cm serve --metrics`` and the board's sensors in the status, over the processes that users run."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from manager_process import Manager, served, until
from scraping import address, scrape

from cm.cli.main import main
from cm.simulation.software import Board as SimBoard


@pytest.fixture(scope="module")
def scraped() -> Iterator[tuple[Manager, SimBoard]]:
    with served(arguments=["--metrics", "0"]) as both:
        with both[0].connected() as board:
            board.load("camera", "default")
        yield both


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
