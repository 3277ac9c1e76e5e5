# SPDX-License-Identifier: Apache-2.0
"""Why a board is as it is, in sentences. What is not recorded is "not known": nothing is guessed."""

from __future__ import annotations

import time
from collections.abc import Iterator

from cm.errors import NotFound
from cm.recording.story import Story
from cm.recording.times import clock_time
from cm.wire.messages.status import NOTICES, PastChange, PastWrite, RegionStatus, StepTaken, StreamStatus, place

_LOADS = ("load", "repair")
UNKNOWN = "not known"


def explain(story: Story, subject: str = "") -> list[str]:
    """Sentences on a region, a register or a stream; on the whole board where none is named. Raises NotFound."""
    if not subject:
        return [*_board(story), *_parts(story), *_missing(story)]
    status, config = story.status, story.config
    for region in status.regions:
        if region.name == subject:
            return [*_region(story, region), *_missing(story)]
    for stream in status.streams:
        if stream.name == subject:
            return [*_stream(story, stream), *_missing(story)]
    register = subject.partition(".")[0]
    if any(known.name == register for known in config.registers) or register in story.values:
        return [*_register(story, register), *_missing(story)]
    names = [*(r.name for r in status.regions), *(s.name for s in status.streams), *(r.name for r in config.registers)]
    there = f"; there are {', '.join(dict.fromkeys(names))}" if names else ""
    raise NotFound(f"there is no region, register or stream {subject!r}{there}")


def fault(story: Story) -> str:
    """What went wrong last, and its cause, in a sentence; empty where nothing did."""
    ended = [change for change in story.changes if change.ended_ns]
    error = story.status.last_error
    if ended and ended[-1].error is not None:
        return _failed(story, ended[-1])
    if error is not None and error.code not in NOTICES:
        return f"The last error is {error.code}: {error.message}; whose request it was is {UNKNOWN}."
    for stream in story.status.streams:
        if stream.last_error is not None:
            return f"Stream {stream.name}: {stream.last_error.message} [{stream.last_error.code}]."
    return ""


# ---- the board -------------------------------------------------------------------------------


def _board(story: Story) -> Iterator[str]:
    status = story.status
    last = max((c for c in story.changes if c.ended_ns and c.error is None), key=lambda c: c.number, default=None)
    held = f"{status.config_name}/{status.mode}" if status.mode else f"no mode of {status.config_name}"
    name = status.board or "the board"
    if not status.config_name:
        yield f"{name} holds nothing that the manager has loaded."
    elif last is not None and (last.config_name, last.mode) == (status.config_name, status.mode):
        yield f"{name} is in {held} since {_at(story, last.ended_ns)}: {_asked(last)}; it took {took(last)}."
    else:
        yield f"{name} is in {held}; since when and why is {UNKNOWN}: it was so {_before(story)}."
    running = next((change for change in story.changes if not change.ended_ns), None)
    if running is not None and status.fpga_busy:
        step = running.steps[-1] if running.steps else None
        doing = f", at {step.kind} {step.subject}".rstrip() if step else ""
        yield f"A change to {place(running.config_name, running.mode)} runs{doing}: {_asked(running)}."
    wrong = fault(story)
    if wrong:
        yield wrong
    elif status.last_error is not None:
        yield f"The manager notes: {status.last_error.message}."


def _parts(story: Story) -> Iterator[str]:
    for region in story.status.regions:
        yield from _region(story, region)
    outside = {register.name for register in story.config.registers if not register.region}
    for write in story.writes:
        if write.name in outside:
            yield f"{_sentence(_written(story, write))}."
    for stream in story.status.streams:
        if stream.open or stream.last_error is not None or stream.name in story.frames:
            yield from _stream(story, stream)
    for irq in story.interrupts.values():
        yield f"Interrupt {irq.name} came {irq.count} times, last at {_at(story, irq.timestamp_ns)}."


def _failed(story: Story, change: PastChange) -> str:
    error = change.error
    assert error is not None
    step = next((step for step in change.steps if step.failed), None)
    at = f" at step {_step(step)}" if step is not None else ""
    goal = place(change.config_name, change.mode)
    return (
        f"Change {change.number} to {goal} failed at {_at(story, change.ended_ns)}{at}: "
        f"{error.message} [{error.code}]; {_asked(change)}."
    )


# ---- regions ---------------------------------------------------------------------------------


def _region(story: Story, region: RegionStatus) -> Iterator[str]:
    change = _loader_of(story, region.name)
    clauses = [*_holding(story, region, change)]
    own = {register.name for register in story.config.registers if register.region == region.name}
    loaded = _end_of(change, region.name) if change is not None else 0
    clauses += [_written(story, write) for write in story.writes if write.name in own and write.at_ns > loaded]
    if region.health is not None and region.health.checks:
        found = region.health
        now = f"{found.wrong_bits} are wrong now" if found.wrong_bits else f"{found.repairs} repairs were made"
        clauses.append(f"{found.upsets} upset bits were found in {found.checks} checks, and {now}")
    yield f"{'; '.join(clauses)}."
    for window in story.status.windows:
        if window.region == region.name and window.writes:
            yield f"{window.client} may write registers of {region.name} by a window: what it wrote is {UNKNOWN}."


def _holding(story: Story, region: RegionStatus, change: PastChange | None) -> Iterator[str]:
    state = "" if region.state == "ready" else f" and is {region.state}"
    held = f"{region.name} holds {region.module or 'no module that is known'}{state}"
    if change is None:
        yield f"{held}; since when and why is {UNKNOWN}: it was so {_before(story)}"
        return
    if _left_cut(change, region.name):
        yield f"{region.name} is empty since {_at(story, change.ended_ns)}: change {change.number}, {_asked(change)}"
        return
    load = next(step for step in reversed(change.steps) if _loads(step, region.name))
    yield f"{held} since {_at(story, _end_of(change, region.name))}: change {change.number}, {_asked(change)}"
    if load.seconds:
        port = f", {_ms(load.port_seconds)} of it the port" if load.port_seconds else ""
        yield f"the load took {_ms(load.seconds)}{port}"
    else:
        yield f"how long the load took is {UNKNOWN}"
    cut = _cut_off(change, region.name)
    if cut:
        yield f"it was decoupled for {_ms(cut)}"
    if change.error is not None:
        yield f"that change failed: {change.error.message}"


def _loader_of(story: Story, region: str) -> PastChange | None:
    """The last change that has begun to load a region, or has unloaded it, of those that are known."""
    known = reversed(story.changes)
    return next((c for c in known if any(_loads(step, region) for step in c.steps) or _left_cut(c, region)), None)


def _left_cut(change: PastChange, region: str) -> bool:
    """Whether a change has unloaded a region."""
    own = [step.kind for step in change.steps if step.subject == region]
    return change.error is None and bool(change.ended_ns) and own[-1:] == ["decouple"]


def _loads(step: StepTaken, region: str) -> bool:
    return step.kind == "load_full" or (step.kind in _LOADS and step.subject == region)


def _end_of(change: PastChange, region: str) -> int:
    """When it had loaded and connected a region."""
    last = [s for s in change.steps if s.subject == region and s.kind in (*_LOADS, "recouple")]
    return last[-1].begun_ns + round(last[-1].seconds * 1e9) if last and last[-1].seconds else change.ended_ns


def _cut_off(change: PastChange, region: str) -> float:
    """Seconds from its decoupling to its last coupling; 0 where that is not recorded."""
    steps = [step for step in change.steps if step.subject == region]
    first = next((step for step in steps if step.kind == "decouple" and step.seconds), None)
    last = next((step for step in reversed(steps) if step.kind == "recouple" and step.seconds), None)
    return (last.begun_ns - first.begun_ns) / 1e9 - first.seconds + last.seconds if first and last else 0.0


# ---- registers and streams -------------------------------------------------------------------


def _register(story: Story, name: str) -> Iterator[str]:
    known = next((register for register in story.config.registers if register.name == name), None)
    region = known.region if known is not None else ""
    write = next((write for write in story.writes if write.name == name), None)
    change = next((c for c in reversed(story.changes) if any(_sets(step, name) for step in c.steps)), None)
    loader = _loader_of(story, region) if region else None
    written = write.at_ns if write is not None else 0
    step = next(step for step in reversed(change.steps) if _sets(step, name)) if change is not None else None
    if loader is not None and _end_of(loader, region) > max(written, step.begun_ns if step else 0):
        at = _at(story, _end_of(loader, region))
        how = "unloaded" if _left_cut(loader, region) else "loaded"
        yield f"{name} was reset at {at}, when {region} was {how}: change {loader.number}, {_asked(loader)}."
    elif step is not None and change is not None and step.begun_ns > written:
        at = _at(story, step.begun_ns)
        goal = f"{change.config_name}/{change.mode}"
        yield f"{name} was set at {at} by change {change.number} to {goal}, {_asked(change)}."
    elif write is not None:
        yield f"{_sentence(_written(story, write))}."
    else:
        yield f"Who wrote {name}, and when, is {UNKNOWN}: nobody did through the manager {_since(story)}."
    if name in story.values:
        yield f"The record's last value of {name} is {story.values[name]:#x}."
    for window in story.status.windows:
        if window.region == (region or "static") and window.writes:
            yield f"{window.client} may write it by a window: whether it did is {UNKNOWN}."


def _sets(step: StepTaken, register: str) -> bool:
    return step.kind == "registers" and step.subject == register


def _written(story: Story, write: PastWrite) -> str:
    return f"{write.name}={write.value:#x} was written at {_at(story, write.at_ns)} by {write.by or _nobody()}"


def _stream(story: Story, stream: StreamStatus) -> Iterator[str]:
    flow = f"flows at {stream.rate:.1f} frames/s" if stream.open else "is closed"
    clauses = [f"stream {stream.name} {flow}; {stream.frames} frames came, {stream.dropped} were dropped"]
    count, missing = story.frames.get(stream.name, (0, 0))
    if count:
        clauses.append(f"the record has {count} of its frames, and {missing} are missing between them")
    for client in stream.clients:
        if client.dropped:
            clauses.append(
                f"pid {client.pid} ({client.name}) lost {client.dropped}: it holds {client.held} of the {client.depth} "
                "that it may"
            )
    if stream.last_error is not None:
        clauses.append(f"it failed last, when is {UNKNOWN}: {stream.last_error.message} [{stream.last_error.code}]")
    yield f"{_sentence('; '.join(clauses))}."


# ---- words -----------------------------------------------------------------------------------


def _missing(story: Story) -> Iterator[str]:
    for gap in story.gaps:
        what = f" of {gap.topic}" if gap.topic else ""
        count = f"{gap.messages} messages{what}" if gap.messages else f"something{what}"
        yield f"From {_clock(gap.from_ns)} to {_clock(gap.until_ns)} {count} is missing ({gap.cause}): {gap.text}."


def _asked(change: PastChange) -> str:
    if change.by:
        return f"asked for by {change.by}" + (f", {change.why}" if change.why else "")
    return f"made by the manager itself, {change.why}" if change.why else f"who asked for it is {UNKNOWN}"


def _nobody() -> str:
    return f"somebody who is {UNKNOWN}"


def _before(story: Story) -> str:
    return f"{'when the record began' if story.recorded else 'before this manager began'}, at {_clock(story.since_ns)}"


def _since(story: Story) -> str:
    return f"since {'the record began' if story.recorded else 'this manager began'} at {_clock(story.since_ns)}"


def _step(step: StepTaken) -> str:
    return f"{step.kind} {step.subject}".rstrip() + (" of the way back" if step.back else "")


def took(change: PastChange) -> str:
    """How long a change took, for a sentence."""
    return _ms((change.ended_ns - change.begun_ns) / 1e9)


def _at(story: Story, monotonic_ns: int) -> str:
    return _clock(monotonic_ns + story.offset_ns)


def _clock(wall_ns: int) -> str:
    """The time of day of this machine; where it is another day, with the date."""
    return clock_time(wall_ns, date=time.localtime(wall_ns / 1e9)[:3] != time.localtime()[:3])


def _ms(seconds: float) -> str:
    return f"{seconds:.1f} s" if seconds >= 0.9995 else f"{1000 * seconds:.3g} ms"


def _sentence(text: str) -> str:
    """With a capital, unless it begins with a name."""
    return text[:1].upper() + text[1:] if text.startswith("stream ") else text
