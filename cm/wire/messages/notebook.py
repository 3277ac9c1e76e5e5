# SPDX-License-Identifier: Apache-2.0
"""What notebooks show of a status, a plan and registers: tables without a style of their own."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from typing import Any


def table(headers: Sequence[str], rows: Iterable[Sequence[object]], title: str = "") -> str:
    """Rows of text under headers; nothing if there are none."""
    lines = ["".join(f"<td style='text-align:left'>{_text(cell)}</td>" for cell in row) for row in rows]
    if not lines:
        return ""
    caption = f"<caption style='text-align:left'>{_text(title)}</caption>" if title else ""
    head = "".join(f"<th style='text-align:left'>{_text(name)}</th>" for name in headers)
    return f"<table>{caption}<tr>{head}</tr>{''.join(f'<tr>{line}</tr>' for line in lines)}</table>"


def paragraph(text: str, strong: str = "") -> str:
    """A line of text, with something strong before it."""
    return f"<p>{f'<b>{_text(strong)}</b> ' if strong else ''}{_text(text)}</p>"


def progress(fraction: float, text: str) -> str:
    """A bar, and the present step."""
    share = min(max(fraction, 0.0), 1.0)
    return f"<progress max='1' value='{share:.3f}'></progress> {_text(text)}"


def status(s: Any) -> str:
    """A `cm.wire.messages.status.Status`."""
    loaded = f"{s.config_name}/{s.mode or 'no mode'}" if s.config_name else "nothing loaded"
    goes_on = s.pr_mode.value
    if s.progress is not None:
        goes_on += f": {s.progress.target_config}/{s.progress.target_mode}, {s.progress.step} {s.progress.subject}"
    lines = [paragraph(goes_on, strong=f"{s.board}: {loaded}" if s.board else loaded)]
    if s.last_error is not None:
        lines.append(paragraph(s.last_error.message, strong=f"last error: {s.last_error.code}"))
    lines.append(table(("region", "module", "state"), [(r.name, r.module or "-", r.state) for r in s.regions]))
    flows = [
        (x.name, x.direction, _shape(x.shape), x.dtype, x.frames, x.dropped, f"{x.rate:.1f}/s" if x.open else "closed")
        for x in s.streams
    ]
    lines.append(table(("stream", "direction", "shape", "dtype", "frames", "dropped", "flow"), flows))
    return "".join(lines)


def plan(p: Any) -> str:
    """A `cm.wire.messages.status.PlanInfo`."""
    goal = f"{p.config_name}/{p.mode or 'no mode'}"
    if not p.steps:
        return paragraph("nothing to do, the board is already in this mode", strong=goal)
    rows = [(step.text, step.bytes or "", f"{step.seconds * 1000:.2f}" if step.seconds else "") for step in p.steps]
    return table(("step", "bytes", "ms"), rows, f"{goal}: {p.bytes} bytes to load, about {p.seconds * 1000:.1f} ms")


def registers(info: Iterable[Any], values: Any) -> str:
    """`cm.wire.messages.status.RegisterInfo` with their values; a dash for registers that `values` does not contain."""
    rows: list[tuple[object, ...]] = []
    for r in info:
        value = values.get(r.name)
        rows.append((r.name, f"{r.address:#x}", r.access, _value(value), _range(r), r.region or "static", r.doc))
        for f in r.fields:
            held = None if value is None else value >> f.lsb & (1 << f.width) - 1
            named = next((name for name, number in f.values if number == held), "")
            text = f"{_value(held)}{f' {named}' if named else ''}"
            choice = ", ".join(f"{name}={number}" for name, number in f.values)
            rows.append((f"\N{NO-BREAK SPACE}.{f.name}", f"bit {f.lsb}", "", text, choice, "", f.doc))
    return table(("register", "address", "access", "value", "range", "region", "meaning"), rows)


def _range(r: Any) -> str:
    if r.minimum is None and r.maximum is None:
        return ""
    return f"{r.minimum or 0} to {(1 << r.width) - 1 if r.maximum is None else r.maximum}"


def _value(value: int | None) -> str:
    return "-" if value is None else f"{value}" if value < 10 else f"{value} ({value:#x})"


def _shape(shape: Sequence[int]) -> str:
    return " x ".join(map(str, shape)) or "-"


def _text(value: object) -> str:
    return escape(str(value))
