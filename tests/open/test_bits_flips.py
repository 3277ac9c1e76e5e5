# SPDX-License-Identifier: Apache-2.0
"""A flipped bit misbehaves as it would: compared with nextpnr's routed design in yosys' models of the cells."""

from __future__ import annotations

import collections
import os
from itertools import islice
from pathlib import Path

import pytest
from expected import Change, run
from flips import Flips
from routed import Routed

pytestmark = pytest.mark.timeout(7200)
COUNT = int(os.environ.get("CM_FLIPS", "30"))  # make soak: 1000
SEED = int(os.environ.get("CM_SEED", "1"))


def test_flipped_bits_do_what_the_routed_design_says(routed: Routed, tmp_path: Path) -> None:
    flips = Flips(routed, SEED)
    sound = run(tmp_path, flips.design.verilog(Change()), flips.values)
    assert -1 not in sound
    wrong, differ, known = [], collections.Counter[str](), 0
    for flip in islice(flips.draw(), COUNT):
        wanted, found = flips.wanted(flip, tmp_path), flips.found(flip)
        differ[flip.kind] += wanted != sound
        known += sum(value >= 0 for value in wanted)
        if any(value not in (-1, seen) for value, seen in zip(wanted, found, strict=True)):
            wrong.append(f"{flip.kind} {flip.name} (bit {flip.bit})")
    assert not wrong
    assert known > 0.8 * COUNT * len(flips.values)  # the models of the cells seldom do not know
    assert all(differ[kind] for kind in ("table", "mode", "pip"))  # it is seen that they are flipped
