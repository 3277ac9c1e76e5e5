# SPDX-License-Identifier: Apache-2.0
"""A flipped bit misbehaves as it would: compared with nextpnr's routed design in yosys' models of the cells."""

from __future__ import annotations

import collections
import os
from itertools import islice
from pathlib import Path

import pytest
from flips import TURNS, Flips
from routed import Routed

pytestmark = pytest.mark.timeout(7200)
COUNT = int(os.environ.get("CM_FLIPS", "48"))  # make soak: 1000 for each of five seeds
SEED = int(os.environ.get("CM_SEED", "1"))


def test_flipped_bits_do_what_the_routed_design_says(
    routed: Routed, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flips = Flips(routed, SEED)
    sound = flips.sound(tmp_path)
    assert -1 not in sound
    drawn, wrong = list(islice(flips.draw(), COUNT)), []
    every, seen, unknown = collections.Counter[str](), collections.Counter[str](), collections.Counter[str]()
    for flip, wanted, found in zip(drawn, flips.wanted(drawn, tmp_path), flips.found(drawn, tmp_path), strict=True):
        every[flip.kind] += 1
        seen[flip.kind] += any(value not in (-1, good) for value, good in zip(wanted, sound, strict=True))
        unknown[flip.kind] += -1 in wanted or -1 in found
        if any(one != other and -1 not in (one, other) for one, other in zip(wanted, found, strict=True)):
            wrong.append(f"{flip.kind} {flip.name} (bit {flip.bit})")
    with capsys.disabled():
        print(f"\n{COUNT} flips, seed {SEED}: how many, how many seen from outside, how many the models leave open")
        for kind, count in sorted(every.items()):
            print(f"  {kind:18} {count:4} {seen[kind]:4} {unknown[kind]:4}")
        print(f"  {'all':18} {COUNT:4} {seen.total():4} {unknown.total():4}")
    assert not wrong
    assert unknown.total() < 0.1 * COUNT
    assert {kind.partition(" ")[0] for kind in every} == set(TURNS[:COUNT])
    assert all(any(seen[kind] for kind in every if kind.startswith(what)) for what in ("table", "register", "pip"))
