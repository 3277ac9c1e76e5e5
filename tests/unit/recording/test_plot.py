# SPDX-License-Identifier: Apache-2.0
"""A record as a picture: what happened stands at its time, what failed in red, what is missing hatched."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

pytest.importorskip("mcap", reason="records need mcap")
from recording_support import BEGAN, write_record

from cm.cli.main import main
from cm.recording.plot import drawn, svg
from cm.recording.reader import Record
from cm.wire import cm_pb2 as pb
from cm.wire.messages.status import ErrorInfo, PrMode, RegionHealth, RegionStatus, Status

pytestmark = pytest.mark.networks
SVG = "{http://www.w3.org/2000/svg}"


def status(sequence: int, module: str, mode: str, change: int, upsets: int = 0, **more: Any) -> Status:
    state = "failed" if more.get("pr_mode") is PrMode.ERROR else "ready"
    region = RegionStatus("prr0", module, state, health=RegionHealth(1, upsets, upsets))
    return Status(
        "camera", mode, sequence=sequence, board="kria", started_ns=1, regions=(region,), last_change=change, **more
    )


@pytest.fixture
def record(tmp_path: Path) -> Path:
    error = ErrorInfo("load_failed", "the CRC <does> not match")
    frames = [(n / 10, "cm_frame/camera", pb.FrameSeen(frame=pb.Frame(stream="camera", sequence=n))) for n in range(40)]
    gap = pb.Gap(from_ns=BEGAN + 5 * 10**9, until_ns=BEGAN + 6 * 10**9, cause="disk_full", text="the disk was full")
    events = [
        (0.0, "cm_status", status(1, "default", "default", 1)), *frames,
        (4.0, "cm_status", status(2, "edge", "edge", 2, last_change_seconds=0.02)),
        (6.0, "cm_gap", gap),
        (7.0, "cm_status", status(3, "edge", "", 3, 2, pr_mode=PrMode.ERROR, last_error=error)),
        (10.0, "cm_status", status(4, "edge", "", 3, 2, pr_mode=PrMode.ERROR, last_error=error)),
    ]  # fmt: skip
    return write_record(tmp_path / "a.mcap", events)


def test_what_is_drawn_stands_at_its_time(record: Path) -> None:
    picture = ElementTree.fromstring(svg(drawn(Record(record))))
    said = [title.text or "" for title in picture.iter(f"{SVG}title")]
    text = "".join(picture.itertext())
    assert "2 changes, 1 of them failed; 40 frames; 2 upset bits, 2 repairs; 1 gaps (hatched)" in text
    assert any("change 3 to camera/" in line and "the CRC <does> not match" in line for line in said)
    assert "the disk was full" in said
    assert len([mark for mark in picture.iter(f"{SVG}path") if mark.get("class") == "badmark"]) == 1
    lanes = {r.get("class"): r for r in picture.iter(f"{SVG}rect") if r.find(f"{SVG}title") is not None}
    default, edge, failed = (float(lanes[kind].get("width", "0")) for kind in ("m0", "m1", "bad"))
    assert (default / edge, edge / failed) == pytest.approx((4 / 3, 1.0), rel=0.02)
    assert "10 frames/s" in text


def test_both_schemes_have_all_colours(record: Path) -> None:
    style = ElementTree.fromstring(svg(drawn(Record(record)))).find(f"{SVG}style")
    assert style is not None
    light, dark = (style.text or "").split("@media (prefers-color-scheme:dark)")
    names = {part.split("{")[0] for part in light.split("}") if "{" in part}
    assert names == {part.split("{")[0] for part in dark.strip("{}").split("}") if "{" in part}
    assert light != dark.strip("{}")


def test_the_command_writes_the_picture_and_says_what_is_damaged(
    record: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, whole = record.with_suffix(".svg"), record.read_bytes()
    record.write_bytes(whole[: whole.index(b"the disk was full")])
    assert main(["record", "plot", str(record), str(out)]) == 0
    assert ElementTree.parse(out).getroot().tag == f"{SVG}svg"
    assert "a.mcap: it " in capsys.readouterr().out


@pytest.mark.parametrize("action", ["plot", "repair"])
@pytest.mark.parametrize(("folder", "why"), [("none", "No such file or directory"), ("a.mcap", "Not a directory")])
def test_a_place_that_cannot_be_written_is_named_as_it_was_given(
    record: Path, capsys: pytest.CaptureFixture[str], action: str, folder: str, why: str
) -> None:
    out = record.parent / folder / "b.svg"
    assert main(["record", action, str(record), str(out)]) == 1
    assert capsys.readouterr().err == f"cm: {out}: {why}\n"
