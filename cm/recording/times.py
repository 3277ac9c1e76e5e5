# SPDX-License-Identifier: Apache-2.0
"""Times within a record, as people write them: a time of day, or seconds since its beginning."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from contextlib import suppress

from cm.errors import InvalidRequest
from cm.recording.layout import Opened
from cm.recording.reader import Event

_FORMS = ("%H:%M:%S", "%H:%M", "%Y-%m-%d %H:%M:%S", "%Y-%m-%dT%H:%M:%S")
_CLOCK = 10**9  # nanoseconds between two clocks: for how long at most nothing is told
_STATE = 50_000_000  # nanoseconds in which a recorder writes the state that a record begins with


def time_in(text: str, opened: Opened) -> int:
    """The time of the record that ``+7.5``, ``12:03:07.25`` or ``2026-03-01T12:03:07`` means. Raises InvalidRequest.

    A time of day is the first one after the beginning.
    """
    if text.startswith("+"):
        with suppress(ValueError, OverflowError):
            return opened.started_ns + round(float(text[1:]) * 1e9)
    whole, _, fraction = text.partition(".")
    for form in _FORMS:
        with suppress(ValueError, OverflowError):
            parts = time.strptime(whole, form)
            began = time.localtime(opened.started_ns / 1e9)
            day = parts[:3] if "%Y" in form else began[:3]
            at = time.mktime((*day, *parts[3:6], 0, 0, -1))
            nanoseconds = round(at * 1e9) + (round(float(f"0.{fraction}") * 1e9) if fraction else 0)
            over = "%Y" not in form and nanoseconds < opened.started_ns - 10**9
            return nanoseconds + 86_400 * 10**9 if over else nanoseconds
    raise InvalidRequest(f"{text!r} is no time in a record, such as 12:03:07 or +7.5 (seconds since its beginning)")


def until(events: Iterable[Event], opened: Opened, text: str) -> Iterator[Event]:
    """The events up to a time. Raises InvalidRequest, also for a time of which nothing is recorded, in the end too."""
    end, began, last = time_in(text, opened), 0, 0
    for event in events:
        last = event.time_ns
        if not began:
            began = last
            if end < began - _CLOCK:  # a ring may have lost what it began with
                raise InvalidRequest(f"{text!r} is before the record, which begins at {_in_record(began, opened)}")
            end = max(end, began + _STATE)
        if last > end:
            return
        yield event
    if end > last + _CLOCK:
        raise InvalidRequest(f"{text!r} is after the record, which ends at {_in_record(last, opened)}")


def clock_time(wall_ns: int, date: bool = False) -> str:
    """The time of day of this machine, with the date if that is wanted."""
    return time.strftime("%Y-%m-%d %H:%M:%S" if date else "%H:%M:%S", time.localtime(wall_ns / 1e9))


def _in_record(time_ns: int, opened: Opened) -> str:
    return f"{clock_time(time_ns, date=True)} (+{(time_ns - opened.started_ns) / 1e9:.1f})"
