# SPDX-License-Identifier: Apache-2.0
"""How long a configuration port is given for a load: as long as its description says."""

from __future__ import annotations

import contextlib
import errno
import time
from collections.abc import Iterator
from pathlib import Path

import plsim
import pytest

from cm.device import IcapErrors

pytestmark = pytest.mark.needs("cm", "dma", "plsim")
USUAL_S = 2  # of a port that says nothing


@contextlib.contextmanager
def hanging(timeout_ms: int) -> Iterator[Path]:
    """A board whose port takes nothing for as long as the file given here holds 1."""
    port: plsim.Attributes = {"kind": "icap", "timeout_ms": timeout_ms}
    with plsim.nothing(), plsim.board({"icap": port}, {}) as engine:
        hang = engine / "icap/hang"
        hang.write_text("1")
        yield hang


def test_a_load_may_take_longer_than_usual(tmp_path: Path) -> None:
    with hanging(600_000) as hang, plsim.loading(tmp_path) as end:
        time.sleep(USUAL_S + 1)
        hang.write_text("0")
        assert end().status == 0


def test_a_load_that_does_not_end_is_given_up(tmp_path: Path) -> None:
    with hanging(50), plsim.loading(tmp_path) as end:
        done = end()
    assert (done.status, done.errors) == (-errno.ETIMEDOUT, IcapErrors.TIMEOUT)
