# SPDX-License-Identifier: Apache-2.0
"""Figures of an open stream: its rate, the median of its latencies, and why a transfer failed."""

from __future__ import annotations

import errno
from types import SimpleNamespace
from typing import Any

import pytest

from cm.server.streams import stream
from cm.wire.messages.status import ErrorInfo


@pytest.mark.parametrize(
    ("ages", "frames"),
    [
        ([], 0.0), ([0.5], 1.0), ([1.0], 0.0), ([2.0], 0.0), ([1.1, 0.3, 0.2, 0.1], 10.0), ([0.9, 0.4], 2.0),
        ([0.4, 0.4], 2.0),
    ],
)  # fmt: skip
def test_a_rate_is_that_of_the_last_second(monkeypatch: pytest.MonkeyPatch, ages: list[float], frames: float) -> None:
    monkeypatch.setattr(stream, "time", SimpleNamespace(monotonic_ns=lambda: 10**12))
    counts: Any = SimpleNamespace(at_ns=[10**12 - round(age * 1e9) for age in ages])
    assert stream.rate(counts) == pytest.approx(frames)


def test_a_median_is_in_the_middle_and_a_failed_transfer_is_told() -> None:
    assert [stream.median(values) for values in ([], [3], [9, 1, 5], [4, 1, 2, 3])] == [0, 3, 5, 3]
    more = "; the packet was longer than the frame, or the bus reported an error"
    for error, write, said in (
        (errno.EIO, False, f"Input/output error{more}"), (errno.EIO, True, "Input/output error"),
        (errno.ETIMEDOUT, False, "Connection timed out"), (0, False, None),
    ):  # fmt: skip
        for came, after in ((0, ""), (4000, " after 4000")):
            counts: Any = SimpleNamespace(error=error, asked=4096, came=came)
            told = stream.transfer_error(counts, write)
            assert told == (said and ErrorInfo("transfer_failed", f"a transfer of 4096 bytes failed{after}: {said}"))
