# SPDX-License-Identifier: Apache-2.0
"""Compiled libraries by content: made once, and deleted when they are no longer used."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest

from cm.simulation.rtl import cache
from cm.simulation.rtl.compile import widened
from cm.simulation.rtl.errors import RtlError


def made(folder: Path, name: str, text: str = "library") -> Path:
    return cache.made(folder, name, lambda target, _: target.write_text(text) and None)


def test_an_entry_is_made_only_once(tmp_path: Path) -> None:
    assert made(tmp_path, "one", "first").read_text() == "first"
    assert made(tmp_path, "one", "second").read_text() == "first"


def test_entries_unused_for_two_months_are_forgotten_and_used_ones_stay(tmp_path: Path) -> None:
    old = time.time() - 90 * 86400
    for name in ("used", "unused"):
        os.utime(made(tmp_path, name), (old, old))
    (tmp_path / ".making-killed").mkdir()
    os.utime(tmp_path / ".making-killed", (old, old))
    made(tmp_path, "used")
    made(tmp_path, "new")
    assert {path.name for path in tmp_path.iterdir()} == {"used", "new"}


def test_a_failed_compilation_leaves_nothing(tmp_path: Path) -> None:
    def fails(target: Path, _: Path) -> None:
        target.write_text("half")
        raise RtlError("does not compile")

    with pytest.raises(RtlError):
        cache.made(tmp_path, "one", fails)
    assert not list(tmp_path.iterdir())


def test_local_variables_become_words_but_those_whose_address_is_taken() -> None:
    code = "    CData/*0:0*/ __Vdly__valid;\n    SData/*15:0*/ count;\n    CData/*7:0*/ read;\n    f(8, &(read));\n"
    assert widened(code) == (
        "    IData/*0:0*/ __Vdly__valid;\n    IData/*15:0*/ count;\n    CData/*7:0*/ read;\n    f(8, &(read));\n"
    )
