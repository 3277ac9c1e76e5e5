# SPDX-License-Identifier: Apache-2.0
"""What of a record can be run again, in its order: and, by name, what cannot."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any

from cm.errors import CmError, InvalidRequest
from cm.frozen import dataclass
from cm.recording.layout import AUDIT, CONFIG, FRAME_PREFIX, REGISTERS, STATUS, STREAM_PREFIX
from cm.recording.reader import Event, Record
from cm.recording.story import Story, stories
from cm.wire.decode import decode_request
from cm.wire.messages import requests as rq
from cm.wire.messages.status import Audit, PastChange, Status

# Of each the message stands in the record whole, and means the same to another manager.
_AGAIN = (rq.ChangeMode, rq.WriteReg, rq.CheckRegion, rq.ConfigureStream, rq.DefineMemory, rq.RemoveConfig)
_OTHERS = {
    "WriteData": "its data are not in a record", "Provision": "its files are not in a record",
    "Upload": "its data are not in a record", "CancelChange": "it depends on the moment within a change",
    **dict.fromkeys(("TakeLease", "RenewLease", "ReleaseLease", "BreakLease"), "ids of leases are not in a record"),
}  # fmt: skip
# What a step's failure says in the record → the fault of the simulated board that makes it fail so: kind, and target.
_FAULTS: tuple[tuple[str, str], ...] = (
    (r"^load (\S+) into (\S+) .*the CRC does not match", "icap_crc"),
    (r"^load (\S+) into (\S+) .*another device \(IDCODE\)", "icap_id"),
    (r"^load (\S+) into (\S+) by icap.*(did not finish|took .* for more than)", "icap_hang"),
    (r"^load (?P<module>\S+) into (?P<region>\S+) by overlay", "overlay_error"),
    (r"^load (\S+) into (\S+) by fpga_manager", "fpga_manager_error"),
    (r"^load the whole device from", "fpga_manager_error"),
    (r"^apply overlay (?P<target>[^:\s]+)", "overlay_error"),
    (r"^set (?P<target>\S+) = ", "register_stuck"),
    (r"^set clock (?P<target>\S+) to", "clock_stuck"),
)
_LASTING = ("register_stuck", "clock_stuck")  # until they are cleared


@dataclass(frozen=True, slots=True)
class Fault:
    """A fault of the simulated board (`cm sim inject`); `lasting`: it strikes again until it is cleared."""

    kind: str
    target: str = ""
    lasting: bool = False


@dataclass(frozen=True, slots=True)
class State:
    """Where a change ended: how it went, and what the board was in then. Two runs are alike where these are.

    `steps` are (kind, subject) in their order, the way back included.
    """

    goal: str
    error: str
    steps: tuple[tuple[str, str], ...]
    place: str
    pr_mode: str
    regions: tuple[tuple[str, str, str], ...]  # name, module, state

    def __str__(self) -> str:
        how = f"failed ({self.error})" if self.error else "done"
        held = ", ".join(f"{name} {module or '-'} ({state})" for name, module, state in self.regions)
        return f"{self.goal} {how}, in {self.place or 'no mode'}, {self.pr_mode}: {held}; {len(self.steps)} steps"


@dataclass(frozen=True, slots=True)
class Script:
    """A record as it is run again. `left_out`: sentences on what cannot be."""

    record: Record
    schemas: Mapping[str, str]
    first: Status
    values: Mapping[str, int]  # of registers at the beginning
    requests: tuple[tuple[int, Any], ...]  # with the time of the record at which each was let through
    changes: tuple[PastChange, ...]
    states: tuple[State, ...]  # at the end of each of them
    streams: frozenset[str]  # whose frames have their data in the record
    left_out: tuple[str, ...]


def fault_of(change: PastChange) -> Fault | None:
    """The fault that makes a change fail as it did; None where it went well, or none of the board's is known to."""
    if change.error is None:
        return None
    message = change.error.message
    for pattern, kind in _FAULTS:
        found = re.search(pattern, message)
        if found is None:
            continue
        parts = found.groupdict()
        target = parts.get("target") or (f"cm-{parts['region']}" if parts.get("region") else "")
        return Fault(kind, target, kind in _LASTING or "going back failed" in message)
    return None


def needs_fault(change: PastChange) -> bool:
    """Whether a change failed at the hardware: what the manager itself refuses, it refuses again."""
    return change.error is not None and "nothing was touched" not in change.error.message and any(
        step.kind not in ("validate", "static") for step in change.steps
    )  # fmt: skip


def state_of(story: Story, change: PastChange) -> State:
    """Where a change ended, as the story behind its end tells."""
    steps: list[tuple[str, str]] = []
    for step in change.steps:
        one = step.kind, step.subject
        if step.kind != "validate" and one not in steps[-1:]:
            steps.append(one)
    s = story.status
    regions = tuple((r.name, r.module or "", r.state) for r in s.regions)
    place = f"{s.config_name}/{s.mode}" if s.mode else s.config_name
    error = change.error.code if change.error is not None else ""
    return State(f"{change.config_name}/{change.mode}", error, tuple(steps), place, s.pr_mode.value, regions)


def ended_states(ended: dict[int, State], story: Story, but: int = 0) -> None:
    """Add the state of the change that a story's status is the end of, if it is numbered above `but`.

    A story may know of later changes, which a history tells before their statuses come, and of earlier ones.
    """
    number = story.status.last_change
    if story.status.fpga_busy or number <= but or number in ended:
        return
    for change in story.changes:
        if change.number == number and change.ended_ns:
            ended[number] = state_of(story, change)


def read_script(
    record: Record, since: int = 0, until: int = 1 << 63, wanted: Callable[[str], bool] = lambda _: True
) -> Script:
    """What a record has to be run again between two of its times. Raises InvalidRequest where that is nothing."""
    schemas: dict[str, str] = {}
    requests: dict[tuple[int, str], tuple[int, Any]] = {}
    left_out: dict[str, None] = {}
    first: Story | None = None
    states: dict[int, State] = {}
    changes: dict[int, PastChange] = {}
    seen: dict[str, bool] = {}

    def note(event: Event) -> Event:
        if event.topic == CONFIG and event.value.schema:
            schemas[event.value.name] = event.value.schema
        elif event.topic == AUDIT and since <= record.opened.time_of(event.value.began_ns):
            _note_request(event.value, record.opened.time_of(event.value.began_ns), requests, left_out)
        elif event.topic.startswith(FRAME_PREFIX) and wanted(event.topic):
            name = event.value.frame.stream
            seen[name] = seen.get(name, False) or event.value.kept
        return event

    last_first = 0
    events = (e for e in record.events(lambda topic: not topic.startswith(STREAM_PREFIX)) if e.time_ns <= until)
    for story in stories(record.opened, map(note, events)):
        if story.at_ns < since or not story.status.started_ns:
            continue
        if first is None and not story.status.fpga_busy and (story.config.name or not story.status.config_name):
            if story.status.config_name and not story.values:
                continue  # what the registers held comes right behind
            first = story
            last_first = story.status.last_change
        if first is not None:
            ended_states(states, story, last_first)
            changes.update((c.number, c) for c in story.changes if c.ended_ns and c.number > last_first)
            for window in story.status.windows:
                if window.writes:
                    left_out[f"what {window.client} wrote by its window of {window.region}"] = None
    if first is None:
        raise InvalidRequest("the record has no whole state in that time, from which it could be run again")
    for number in changes.keys() - states.keys():
        left_out[f"how change {number} left the board: the status at its end is not in the record"] = None
        del changes[number]
    for change in changes.values():
        if needs_fault(change) and fault_of(change) is None:
            left_out[f"why change {change.number} failed: {change.error.message if change.error else ''}"] = None
    kept = {name for name, data in seen.items() if data}
    for name in seen.keys() - kept:
        left_out[f"frames of {name}: their data are not in the record, so the simulated board makes its own"] = None
    for problem in record.problems:
        left_out[problem] = None
    numbers = sorted(states)
    return Script(
        record, schemas, first.status, dict(first.values), tuple(requests[key] for key in sorted(requests)),
        tuple(changes[n] for n in numbers), tuple(states[n] for n in numbers), frozenset(kept), tuple(left_out),
    )  # fmt: skip


def _note_request(
    audit: Audit, at: int, requests: dict[tuple[int, str], tuple[int, Any]], left: dict[str, None]
) -> None:
    key = audit.began_ns, audit.client
    if key in requests:
        return
    try:
        request = decode_request([audit.topic.encode(), audit.message])
    except CmError as error:
        left[f"a {audit.request} of {audit.client}: {_OTHERS.get(audit.request, str(error))}"] = None
        return
    if isinstance(request, _AGAIN):
        requests[key] = at, request
    else:
        left[f"{audit.request} of {audit.client}: {_OTHERS.get(audit.request, 'it is not made again')}"] = None


def topics_wanted(names: tuple[str, ...]) -> Callable[[str], bool]:
    """Whether a topic is among those named; all where none is. A stream's name stands for its frames."""
    own = {*names, *(f"{prefix}{name}" for prefix in (FRAME_PREFIX, STREAM_PREFIX) for name in names)}
    basic = (STATUS, CONFIG, REGISTERS, AUDIT) if not names else ()
    return lambda topic: not names or topic in own or topic in basic
