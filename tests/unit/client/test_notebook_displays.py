# SPDX-License-Identifier: Apache-2.0
"""What notebooks display: PNG that others read, and well-formed HTML with the right contents."""

from __future__ import annotations

import io
import sys
from html.parser import HTMLParser
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PIL import Image

import cm
from cm.client.frame import frame_of
from cm.client.picture import png
from cm.client.progress import NotebookBar, Shown, TextBar, bar
from cm.errors import InvalidRequest
from cm.wire.messages import notebook
from cm.wire.messages.status import (
    ErrorInfo,
    FieldInfo,
    FrameInfo,
    PlanInfo,
    PlanStep,
    Progress,
    RegionStatus,
    RegisterInfo,
    Status,
    StreamStatus,
)

RNG = np.random.default_rng(1)


def read(data: bytes | None) -> Image.Image:
    """Decode by an independent reader, to which a wrong checksum is an error."""
    assert data is not None
    image = Image.open(io.BytesIO(data))
    image.load()
    return image


@pytest.mark.parametrize(
    ("shape", "mode"),
    [((7, 11), "L"), ((7, 11, 1), "L"), ((7, 11, 2), "LA"), ((7, 11, 3), "RGB"), ((7, 11, 4), "RGBA"), ((1, 1), "L")],
)
def test_bytes_are_pixels(shape: tuple[int, ...], mode: str) -> None:
    pixels = RNG.integers(0, 256, shape, np.uint8)
    image = read(png(pixels))
    assert image.mode == mode
    assert np.array_equal(np.asarray(image).reshape(shape), pixels)


def test_lines_that_do_not_follow_each_other_are_those_of_the_array() -> None:
    whole = RNG.integers(0, 256, (20, 30), np.uint8)
    assert np.array_equal(np.asarray(read(png(whole[::2, 3:20:3]))), whole[::2, 3:20:3])


@pytest.mark.parametrize("dtype", ["uint16", "int32", "float32", "float64", "int8"])
def test_other_numbers_are_shown_from_their_least_to_their_greatest(dtype: str) -> None:
    ramp = np.linspace(-100 if dtype != "uint16" else 0, 100, 64).astype(dtype).reshape(8, 8)
    seen = np.asarray(read(png(ramp)))
    assert (seen.min(), seen.max()) == (0, 255)
    assert np.all(np.diff(seen.ravel().astype(int)) >= 0)


@pytest.mark.parametrize(
    ("array", "expected"),
    [
        (np.array([[True, False]]), [[255, 0]]),
        (np.array([[3 + 4j, 0j]]), [[255, 0]]),
        (np.array([[np.nan, 1.0, 2.0, np.inf]]), [[0, 0, 255, 255]]),
        (np.array([[7.0, 7.0]]), [[0, 0]]),
        (np.array([[np.nan, np.nan]]), [[0, 0]]),
    ],
)
def test_values_other_than_plain_numbers_have_a_shade_too(array: np.ndarray, expected: list[list[int]]) -> None:
    assert np.asarray(read(png(array))).tolist() == expected


@pytest.mark.parametrize("shape", [(5,), (0, 4), (2, 3, 5), (2, 2, 2, 2), ()])
def test_an_array_without_rows_is_not_a_picture(shape: tuple[int, ...]) -> None:
    with pytest.raises(InvalidRequest, match="no picture"):
        cm.Picture(np.zeros(shape))


def test_a_frame_is_shown_if_it_is_a_picture() -> None:
    pixels = RNG.integers(0, 256, (4, 6), np.uint8)
    frame = frame_of(FrameInfo("camera", 0, 0, 24, (4, 6)), pixels.tobytes())
    assert np.array_equal(np.asarray(read(frame._repr_png_())), pixels)
    assert frame_of(FrameInfo("samples", 0, 0, 24, (24,)), pixels.tobytes())._repr_png_() is None


class Cells(HTMLParser):
    """Reads tables as rows of text; a tag that is not closed, or closed twice, is an error."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.rows: list[list[str]] = []
        self.text = ""
        self._open: list[str] = []
        self.feed(text)
        self.close()
        assert not self._open

    def handle_starttag(self, tag: str, attrs: object) -> None:
        self._open.append(tag)
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data
        if "tr" in self._open:
            self.rows[-1][-1] += data


def test_a_status_is_shown_with_its_regions_streams_and_error() -> None:
    status = Status(
        config_name="camera",
        mode="edge",
        board="kria",
        last_error=ErrorInfo("crc_mismatch", "<b>edge & co</b>.bit is torn"),
        progress=Progress(3, "camera", "default", "load", "prr0"),
        regions=(RegionStatus("prr0", None, "unknown"),),
        streams=(StreamStatus("camera", "cam", "s2mm", (480, 640), "uint8", open=True, frames=7, rate=30.0),),
    )
    shown = Cells(status._repr_html_())
    assert "kria: camera/edge" in shown.text
    assert "camera/default, load prr0" in shown.text
    assert "crc_mismatch" in shown.text
    assert "<b>edge & co</b>.bit is torn" in shown.text, "what stands in it is text"
    assert ["prr0", "-", "unknown"] in shown.rows
    assert ["camera", "s2mm", "480 x 640", "uint8", "7", "0", "30.0/s"] in shown.rows


def test_a_plan_is_shown_with_what_it_costs() -> None:
    plan = PlanInfo("camera", "edge", (PlanStep("load", "prr0", "load edge into prr0", 100, 0.0015),), 100, 0.0015)
    shown = Cells(plan._repr_html_())
    assert shown.rows[1] == ["load edge into prr0", "100", "1.50"]
    assert "100 bytes to load, about 1.5 ms" in shown.text
    assert "nothing to do" in Cells(PlanInfo("camera", "edge", (), 0, 0.0)._repr_html_()).text
    assert str(plan).splitlines() == [
        " 1 load edge into prr0 (100 bytes)",
        "camera/edge: 100 bytes to load, about 1.5 ms",
    ]


def test_registers_are_shown_with_their_fields_and_names_of_values() -> None:
    blink = FieldInfo("blink", 4, 2, values=(("steady", 0), ("fast", 2)))
    info = [RegisterInfo("led", 0x1018, 32, "rw", maximum=255, fields=(blink,)), RegisterInfo("key", 0x20, 32, "wo")]
    shown = Cells(notebook.registers(info, {"led": 0x2F})).rows
    assert shown[1][:5] == ["led", "0x1018", "rw", "47 (0x2f)", "0 to 255"]
    assert [cell.strip() for cell in shown[2][:5]] == [".blink", "bit 4", "", "2 fast", "steady=0, fast=2"]
    assert shown[3][3] == "-"


class Cell:
    """Stands for a notebook's `display`, and for the handle that it gives: what the cell shows."""

    def __init__(self) -> None:
        self.shown: list[str] = []

    def __call__(self, text: Any, display_id: bool) -> Cell:
        self.shown.append(text._repr_html_())
        return self

    def update(self, text: Any) -> None:
        self.shown[-1] = text._repr_html_()


def test_a_long_load_shows_a_bar_in_its_cell_until_it_ends() -> None:
    cell, now = Cell(), 100.0
    with NotebookBar("camera/edge", cell, lambda: now) as bar:
        bar.update(0.1, "validate edge.bit")
        assert cell.shown == []
        now += 0.5
        bar.update(0.25, "load prr0")
        assert "value='0.250'" in cell.shown[0]
        assert "camera/edge load prr0" in Cells(cell.shown[0]).text
        bar.update(7.0)
        assert "value='1.000'" in cell.shown[0]
        assert Cells(cell.shown[0]).text.strip().endswith("camera/edge")
    assert cell.shown == [""]


def test_a_load_that_is_over_at_once_leaves_nothing_in_its_cell() -> None:
    cell = Cell()
    with NotebookBar("camera/edge", cell, lambda: 100.0) as bar:
        bar.update(0.5, "load prr0")
    assert cell.shown == []


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_progress_is_drawn_on_a_terminal_and_wiped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "31")
    terminal = Terminal()
    with TextBar("loading", terminal) as progress:
        progress.update(0.5, "prr0")
        progress.update(0.5, "prr0")
        progress.update(1.0)
    assert terminal.getvalue().split("\r") == [
        "", "loading [####     ]  50 % prr0", "loading [##############] 100 %", " " * 30, ""
    ]  # fmt: skip


def test_progress_is_silent_without_a_terminal() -> None:
    stream = io.StringIO()
    with TextBar("loading", stream) as progress:
        progress.update(0.5)
    assert stream.getvalue() == ""


@pytest.mark.parametrize(
    ("columns", "fraction", "note", "line"),
    [
        (300, 0.25, "", "load [" + "#" * 10 + " " * 30 + "]  25 %"),
        (24, -1.0, "prr0", "load [      ]   0 % prr0"),
        (23, 7.0, "prr0", "load [#####] 100 % prr0"),
        (22, 0.5, "prr0", "load  50 % prr0"),
        (7, 0.5, "prr0", "load  5"),
    ],
)
def test_a_bar_fits_its_line(columns: int, fraction: float, note: str, line: str) -> None:
    assert bar("load", fraction, note, columns) == line


@pytest.mark.parametrize(
    ("shell", "progress", "drawn"),
    [
        (SimpleNamespace(kernel=1), None, NotebookBar),
        (SimpleNamespace(kernel=1), False, None),
        (SimpleNamespace(), None, None),
        (SimpleNamespace(), True, TextBar),
        (None, True, TextBar),
    ],
)
def test_a_load_is_drawn_in_a_notebook_and_on_a_terminal_where_that_is_asked_for(
    monkeypatch: pytest.MonkeyPatch, shell: Any, progress: bool | None, drawn: type[TextBar] | None
) -> None:
    ipython = shell and SimpleNamespace(get_ipython=lambda: shell, display=SimpleNamespace(display=Cell()))
    monkeypatch.setitem(sys.modules, "IPython", ipython)
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setenv("COLUMNS", "80")
    with Shown(progress, "camera", "edge") as shown:
        assert (shown.tell is None) == (drawn is None)
        if shown.tell is not None:
            shown.tell(Progress(7, "camera", "edge", "load", "prr0", 1, 2, 0.5))
    assert (" 50 % load prr0" in terminal.getvalue()) == (drawn is TextBar)
    assert ("\rcamera/edge [#" in terminal.getvalue()) == (drawn is TextBar)


def test_the_package_offers_what_it_has() -> None:
    assert {"Board", "Picture", "aio", "connect", "device", "errors"} <= set(dir(cm))
    assert all(hasattr(cm, name) for name in dir(cm))
    with pytest.raises(AttributeError, match="no attribute 'conect'; did you mean 'connect'"):
        _ = cm.conect
