# SPDX-License-Identifier: Apache-2.0
"""The page of a record: what it shows is as it was at the moment that is chosen, and nothing can be changed."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("mcap", reason="records need mcap")
pytest.importorskip("aiohttp", reason="the page needs aiohttp")
from recording_support import BEGAN, write_record

from cm.cli.main import main
from cm.errors import InvalidRequest
from cm.recording import salvage
from cm.web.commands import NotAllowed
from cm.web.recorded import RecordCommands, RecordedFrames, RecordHub
from cm.web.shown_streams import Wanted
from cm.wire import cm_pb2 as pb
from cm.wire.messages.status import (
    ConfigInfo,
    InterruptInfo,
    Irq,
    ModeInfo,
    RegionStatus,
    RegValue,
    RegValues,
    Status,
    StreamStatus,
)

pytestmark = pytest.mark.web
STREAM = StreamStatus("camera", "dma0", "s2mm", (2, 2), open=True)


def seen(sequence: int) -> pb.FrameSeen:
    return pb.FrameSeen(frame=pb.Frame(stream="camera", sequence=sequence, shape=[2, 2], dtype="uint8"), kept=True)


def status(sequence: int, mode: str) -> Status:
    region = RegionStatus("prr0", mode, "ready")
    return Status("camera", mode, sequence=sequence, board="kria", started_ns=1, regions=(region,), streams=(STREAM,))


@pytest.fixture
def record(tmp_path: Path) -> Path:
    config = ConfigInfo("camera", modes=(ModeInfo("edge"),), interrupts=(InterruptInfo("done", "a frame", 0),))
    events = [
        (0.0, "cm_status", status(1, "default")), (0.1, "cm_read_config", config),
        (0.2, "cm_read_reg", RegValues((RegValue("focus", 1),))),
        (1.0, "cm_frame/camera", seen(1)), (1.0, "cm_stream/camera", b"\x00\x01\x02\x03"),
        (2.0, "cm_status", status(2, "edge")), (3.0, "cm_read_reg", RegValues((RegValue("focus", 5),), generation=4)),
        (4.0, "cm_irq", Irq("done", 7, 5_000_000_000)),
        (5.0, "cm_frame/camera", seen(9)), (5.0, "cm_stream/camera", b"\x09\x09\x09\x09"),
        (6.0, "cm_status", status(3, "edge")),
    ]  # fmt: skip
    return write_record(tmp_path / "night.mcap", events)


async def opened(path: Path) -> tuple[RecordHub, asyncio.Task[None]]:
    hub = RecordHub(path)
    task = asyncio.create_task(hub.run())
    while not (told(hub).get("link") or {}).get("up"):
        await asyncio.sleep(0.01)
    return hub, task


def told(hub: RecordHub) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(hub.topics.message(hub.topics.names()))
    return found


def ms(seconds: float) -> int:
    return BEGAN // 10**6 + round(seconds * 1000)


def test_the_page_shows_the_moment_that_is_chosen(record: Path) -> None:
    async def look() -> None:
        hub, task = await opened(record)
        page = RecordCommands(hub)
        last = told(hub)
        assert (last["status"]["mode"], last["registers"]["focus"]["value"]) == ("edge", 5)
        assert (last["interrupts"]["done"]["count"], last["interrupts"]["done"]["doc"]) == (7, "a frame")
        assert (last["link"]["control"], last["link"]["record"]["name"]) == (False, "night.mcap")
        await page.do("at", {"ms": ms(1.5)})
        then = told(hub)
        assert (then["status"]["mode"], then["registers"]["focus"]["value"]) == ("default", 1)
        assert then["interrupts"]["done"]["count"] == 0
        await page.do("at", {"ms": 0})
        assert told(hub)["status"]["mode"] == "default"
        task.cancel()

    asyncio.run(look())


def test_nothing_of_a_record_is_read_again_or_changed(record: Path) -> None:
    async def ask() -> None:
        hub, task = await opened(record)
        page = RecordCommands(hub)
        for what in ("mode", "write", "cancel", "read", "map", "plan"):
            with pytest.raises(NotAllowed, match="this is a record"):
                await page.do(what, {})
        with pytest.raises(InvalidRequest, match="milliseconds"):
            await page.do("at", {"ms": "noon"})
        task.cancel()

    asyncio.run(ask())


def test_a_stream_shows_the_last_frame_by_then(record: Path) -> None:
    async def look() -> None:
        hub, task = await opened(record)
        frames, wanted, drawn = RecordedFrames(hub), Wanted("auto", True), asyncio.Event()
        frames.watch("page", "camera", wanted, lambda _: drawn.set())
        await asyncio.wait_for(drawn.wait(), 20)
        number, picture = frames.newest("camera", wanted, 0) or (0, b"")
        assert b'"sequence": 9' in picture
        assert picture.endswith(b"\x09\x09\x09\x09")
        drawn.clear()
        await hub.seek((ms(1.5)) * 10**6)
        await asyncio.wait_for(drawn.wait(), 20)
        _, picture = frames.newest("camera", wanted, number) or (0, b"")
        assert b'"sequence": 1' in picture
        assert picture.endswith(b"\x00\x01\x02\x03")
        await frames.close()
        task.cancel()

    asyncio.run(look())


def test_a_moment_s_frame_is_read_by_its_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """However long the record is: the chunk of what is told of the frame, and that of its data."""
    frames = [
        event
        for number in range(1, 101)
        for event in (
            (number / 10, "cm_frame/camera", seen(number)),
            (number / 10, "cm_stream/camera", bytes([number] * 4)),
        )
    ]
    lost = [event for event in frames if event[0] != 5.0 or event[1] != "cm_frame/camera"]
    path = write_record(tmp_path / "long.mcap", [(0.0, "cm_status", status(1, "default")), *lost], finish=False)
    chunks: list[object] = []
    breakup = salvage.breakup_chunk

    async def look() -> None:
        hub, task = await opened(path)
        monkeypatch.setattr(salvage, "breakup_chunk", lambda *a, **k: chunks.append(a) or breakup(*a, **k))
        for seconds, sequence in ((3.04, 30), (9.99, 99), (0.1, 1), (5.05, 49), (100.0, 100)):
            await hub.seek(ms(seconds) * 10**6)
            chunks.clear()
            found = hub.frame("camera")
            assert found is not None
            assert (found[0].sequence, found[1]) == (sequence, bytes([sequence] * 4))
            assert len(chunks) == 2
        await hub.seek(0)
        assert hub.frame("camera") is None
        task.cancel()

    asyncio.run(look())


def test_a_record_goes_without_control(record: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["web", "--record", str(record), "--control"]) == 1
    assert "it goes without --control" in capsys.readouterr().err
