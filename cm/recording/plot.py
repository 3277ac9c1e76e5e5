# SPDX-License-Identifier: Apache-2.0
"""A record as a picture for a report: modes by region, changes and faults, frames a second, upsets, over time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from itertools import cycle
from xml.sax.saxutils import escape

from cm.frozen import dataclass, field
from cm.recording.layout import STREAM_PREFIX
from cm.recording.reader import Record
from cm.recording.story import Story, stories
from cm.recording.times import clock_time
from cm.recording.why import took
from cm.wire.messages.status import PastChange, place

_WIDTH, _LEFT, _RIGHT = 960, 132, 24
_LANE, _CURVE, _GAP = 26, 56, 10
_INKS = {
    "paper": "#ffffff",
    "ink": "#1d2430",
    "dim": "#5b6575",
    "rule": "#d5dae2",
    "bad": "#c4001a",
    "curve": "#1b62a5",
}
_DARK = {
    "paper": "#14181f",
    "ink": "#e6eaf0",
    "dim": "#9aa5b5",
    "rule": "#343c49",
    "bad": "#ff6b74",
    "curve": "#74b3ff",
}
_FILLS = ("#cfe3f7", "#d6efd8", "#f6e3c3", "#e6daf5", "#f7d4dc", "#cdeeee")
_FILLS_DARK = ("#1f3f60", "#22482a", "#57431c", "#40305a", "#5a2833", "#1b4a4a")


@dataclass(slots=True)
class Drawn:
    """What is drawn of a record; times are the record's, in nanoseconds."""

    since: int
    until: int
    held: dict[str, list[tuple[int, str, str]]] = field(default_factory=dict)  # by region: from when on, module, state
    changes: dict[int, PastChange] = field(default_factory=dict)
    offset: int = 0
    frames: dict[str, Counter[int]] = field(default_factory=dict)  # by stream: how many in each step of time
    upsets: list[tuple[int, int]] = field(default_factory=list)
    repairs: list[tuple[int, int]] = field(default_factory=list)
    gaps: list[tuple[int, int, str]] = field(default_factory=list)
    step: int = 1_000_000_000
    board: str = ""


def drawn(record: Record) -> Drawn:
    """Read a record once."""
    made = Drawn(record.opened.started_ns, record.opened.started_ns, offset=record.opened.offset_ns)
    seen: dict[str, int] = {}
    for story in stories(record.opened, record.events(lambda topic: not topic.startswith(STREAM_PREFIX))):
        made.until = max(made.until, story.at_ns)
        _note(made, story, seen)
    return made


def _note(made: Drawn, story: Story, seen: dict[str, int]) -> None:
    status, at = story.status, story.at_ns
    made.board = status.board or made.board
    for region in status.regions:
        lane = made.held.setdefault(region.name, [])
        now = region.module or "", region.state
        if not lane or lane[-1][1:] != now:
            lane.append((at, *now))
    for change in story.changes:
        made.changes[change.number] = change
    for stream, (count, _) in story.frames.items():
        new, seen[stream] = count - seen.get(stream, 0), count
        if new > 0:
            made.frames.setdefault(stream, Counter())[(at - made.since) // made.step] += new
    health = [region.health for region in status.regions if region.health is not None]
    for line, value in ((made.upsets, sum(h.upsets for h in health)), (made.repairs, sum(h.repairs for h in health))):
        if not line or line[-1][1] != value:
            line.append((at, value))
    made.gaps = [(gap.from_ns, gap.until_ns, gap.text) for gap in story.gaps]


def svg(what: Drawn) -> str:
    """An SVG document; it follows the reader's light or dark scheme, and needs nothing beside itself."""
    return "\n".join(_Picture(what).parts())


class _Picture:
    def __init__(self, what: Drawn) -> None:
        self._what = what
        self._span = max(what.until - what.since, 1)
        names = {module for lane in what.held.values() for _, module, _ in lane if module}
        self._classes = dict(zip(sorted(names), cycle(range(len(_FILLS))), strict=False))

    def parts(self) -> Iterator[str]:
        what, top = self._what, 62
        body: list[str] = []
        lanes = [*what.held]
        for name in lanes:
            body += self._lane(name, top)
            top += _LANE + _GAP
        body += self._changes(62, top - _GAP, top)
        top += _LANE + _GAP
        for name, counts in sorted(what.frames.items()):
            body += self._rate(name, counts, top)
            top += _CURVE + _GAP
        if any(value for _, value in (*what.upsets, *what.repairs)):
            body += self._steps("upsets", what.upsets, what.repairs, top)
            top += _CURVE + _GAP
        body += self._gaps(62, top)
        body += self._axis(top)
        height = top + 40
        title = f"{what.board or 'Board'} from {clock_time(what.since, date=True)} to {clock_time(what.until)}"
        yield (
            f'<svg xmlns="http://www.w3.org/2000/svg" role="img" width="{_WIDTH}" height="{height}" '
            f'viewBox="0 0 {_WIDTH} {height}" font-family="sans-serif" font-size="12">'
        )
        yield f"<title>{escape(title)}</title>"
        yield f"<style>{_style()}</style>"
        yield f'<rect class="paper" width="{_WIDTH}" height="{height}"/>'
        yield f'<text class="ink" x="16" y="26" font-size="15" font-weight="600">{escape(title)}</text>'
        yield f'<text class="dim" x="16" y="46">{escape(self._summary())}</text>'
        yield from body
        yield "</svg>\n"

    def _summary(self) -> str:
        what = self._what
        ended = [change for change in what.changes.values() if change.ended_ns and self._inside(change)]
        failed = sum(change.error is not None for change in ended)
        frames = sum(sum(counts.values()) for counts in what.frames.values())
        parts = [f"{len(ended)} changes, {failed} of them failed", f"{frames} frames"]
        upsets = what.upsets[-1][1] if what.upsets else 0
        repairs = what.repairs[-1][1] if what.repairs else 0
        if upsets or repairs:
            parts.append(f"{upsets} upset bits, {repairs} repairs")
        if what.gaps:
            parts.append(f"{len(what.gaps)} gaps (hatched)")
        return "; ".join(parts)

    def _inside(self, change: PastChange) -> bool:
        return change.ended_ns + self._what.offset >= self._what.since

    def _x(self, at: int) -> float:
        share = min(max((at - self._what.since) / self._span, 0.0), 1.0)
        return round(_LEFT + share * (_WIDTH - _LEFT - _RIGHT), 1)

    def _lane(self, name: str, top: int) -> Iterator[str]:
        yield _label(name, top + _LANE / 2 + 4)
        lane = self._what.held[name]
        for (at, module, state), end in zip(lane, [*(a for a, _, _ in lane[1:]), self._what.until], strict=True):
            left, right = self._x(at), self._x(end)
            if right - left < 0.3:
                continue
            kind = (
                f"m{self._classes[module]}" if state == "ready" and module else "bad" if state == "failed" else "none"
            )
            said = f"{module or 'no module'} ({state}) from {clock_time(at)} to {clock_time(end)}"
            yield (
                f'<rect class="{kind}" x="{left}" y="{top}" width="{round(right - left, 1)}" height="{_LANE}" rx="2">'
                f"<title>{escape(said)}</title></rect>"
            )
            text = module if state == "ready" else state
            if right - left > 7.2 * len(text) + 8:
                shade = "on" if state == "failed" else "ink"
                yield f'<text class="{shade}" x="{left + 5}" y="{top + _LANE / 2 + 4}">{escape(text)}</text>'

    def _changes(self, first: int, last: int, top: int) -> Iterator[str]:
        """Each change as a mark; one that failed red, with its number and a line through the regions."""
        yield _label("changes", top + _LANE / 2 + 4)
        yield _rule(top + _LANE / 2)
        for change in self._what.changes.values():
            if not change.ended_ns or not self._inside(change):
                continue
            x = self._x(change.ended_ns + self._what.offset)
            how = f"failed: {change.error.message}" if change.error else f"done in {took(change)}"
            by = f", asked for by {change.by}" if change.by else ""
            said = f"change {change.number} to {place(change.config_name, change.mode)}{by}: {how}"
            kind, middle = ("badmark" if change.error else "mark"), top + _LANE / 2
            if change.error:
                yield f'<line class="badline" x1="{x}" x2="{x}" y1="{first}" y2="{last}"/>'
                shape = f'<path class="{kind}" d="M{x - 5} {middle - 5}l10 10m0 -10l-10 10"/>'
            else:
                shape = f'<circle class="{kind}" cx="{x}" cy="{middle}" r="4"/>'
            yield f"<g><title>{escape(said)}</title>{shape}</g>"

    def _rate(self, name: str, counts: Counter[int], top: int) -> Iterator[str]:
        what = self._what
        most = max(counts.values())
        yield _label(name, top + 16)
        yield _label(f"{most} frames/s", top + 32, "dim")
        yield _rule(top + _CURVE)
        points = []
        for number in range((what.until - what.since) // what.step + 1):
            y = round(top + _CURVE - counts[number] / most * (_CURVE - 6), 1)
            left, right = (self._x(what.since + (number + more) * what.step) for more in (0, 1))
            points += [f"{left} {y}", f"{right} {y}"]
        yield f'<path class="line" d="M{points[0]}L{" ".join(points[1:])}"/>'

    def _steps(
        self, name: str, first: Sequence[tuple[int, int]], second: Sequence[tuple[int, int]], top: int
    ) -> Iterator[str]:
        most = max(value for _, value in (*first, *second)) or 1
        yield _label(name, top + 16)
        yield _label(f"{first[-1][1] if first else 0} bits", top + 32, "dim")
        yield _label(f"{second[-1][1] if second else 0} repairs", top + 46, "dim")
        yield _rule(top + _CURVE)
        for kind, line in (("badstep", first), ("line", second)):
            yield f'<path class="{kind}" d="{self._stairs(line, most, top)}"/>'

    def _stairs(self, line: Sequence[tuple[int, int]], most: int, top: int) -> str:
        level: float = top + _CURVE
        parts = [f"M{_LEFT} {level}"]
        for at, value in line:
            level = round(top + _CURVE - value / most * (_CURVE - 6), 1)
            parts.append(f"H{self._x(at)}V{level}")
        return " ".join([*parts, f"H{self._x(self._what.until)}"])

    def _gaps(self, first: int, last: int) -> Iterator[str]:
        if self._what.gaps:
            yield (
                '<defs><pattern id="gap" width="6" height="6" patternUnits="userSpaceOnUse" '
                'patternTransform="rotate(45)"><line class="hatch" x1="0" x2="0" y1="0" y2="6"/></pattern></defs>'
            )
        for since, until, text in self._what.gaps:
            left, right = self._x(since), self._x(until)
            yield (
                f'<rect fill="url(#gap)" x="{left}" y="{first}" width="{max(3.0, round(right - left, 1))}" '
                f'height="{last - first}"><title>{escape(text)}</title></rect>'
            )

    def _axis(self, top: int) -> Iterator[str]:
        yield _rule(top)
        for at in _ticks(self._what.since, self._what.until):
            x = self._x(at)
            yield f'<line class="rule" x1="{x}" x2="{x}" y1="{top}" y2="{top + 5}"/>'
            yield f'<text class="dim" x="{x}" y="{top + 20}" text-anchor="middle">{clock_time(at)}</text>'


def _ticks(since: int, until: int) -> Iterable[int]:
    """Whole seconds, minutes or hours, eight at most."""
    span = (until - since) / 1e9
    step = next((s for s in (1, 2, 5, 10, 30, 60, 120, 300, 600, 1800, 3600, 7200, 21600) if span / s <= 8), 86400)
    first = -(-since // (step * 10**9)) * step * 10**9
    return range(first, until + 1, step * 10**9)


def _label(text: str, y: float, kind: str = "ink") -> str:
    return f'<text class="{kind}" x="{_LEFT - 12}" y="{y}" text-anchor="end">{escape(text[:18])}</text>'


def _rule(y: float) -> str:
    return f'<line class="rule" x1="{_LEFT}" x2="{_WIDTH - _RIGHT}" y1="{y}" y2="{y}"/>'


def _style() -> str:
    def rules(inks: dict[str, str], fills: Sequence[str]) -> str:
        lines = [
            f".paper{{fill:{inks['paper']}}}.ink{{fill:{inks['ink']}}}.dim{{fill:{inks['dim']}}}.on{{fill:{inks['paper']}}}",
            f".rule,.hatch{{stroke:{inks['rule']}}}.none{{fill:none;stroke:{inks['rule']};stroke-dasharray:3 3}}",
            f".bad{{fill:{inks['bad']}}}.badmark{{stroke:{inks['bad']};stroke-width:2.5}}.badline{{stroke:{inks['bad']};"
            "stroke-dasharray:2 3}",
            f".mark{{fill:{inks['curve']}}}.line{{fill:none;stroke:{inks['curve']};stroke-width:1.5}}",
            f".badstep{{fill:none;stroke:{inks['bad']};stroke-width:1.5}}.hatch{{stroke:{inks['dim']};stroke-width:2}}",
            *(f".m{number}{{fill:{fill}}}" for number, fill in enumerate(fills)),
        ]
        return "".join(lines)

    return f"{rules(_INKS, _FILLS)}@media (prefers-color-scheme:dark){{{rules(_DARK, _FILLS_DARK)}}}"
