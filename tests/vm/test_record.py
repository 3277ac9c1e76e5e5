# SPDX-License-Identifier: Apache-2.0
"""Which boards wait until something that they test has changed."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parent))

from vmboard import record
from vmboard.tiers import TIERS


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A tree that has all that boards test."""
    for part in {*record.TESTED, record.SHIM, "csrc/client", *(part for own in record.OWN.values() for part in own)}:
        (tmp_path / part).mkdir(parents=True, exist_ok=True)
        (tmp_path / part / "file.c").write_text("before")
    return tmp_path


def test_a_board_that_was_good_waits_until_a_source_changes(tree: Path) -> None:
    file, tier = tree / "good.json", TIERS["custom"]
    assert not record.unchanged_since(tier, file, tree)
    record.good(tier, file, tree)
    assert record.unchanged_since(tier, file, tree)
    (tree / "kmod/file.c").write_text("after")
    assert not record.unchanged_since(tier, file, tree)


@pytest.mark.parametrize(
    ("source", "waits"), [("shim.c", False), ("client/cm_plane_wire.h", False), ("client/file.c", True)]
)
def test_programs_of_the_host_are_not_a_boards(tree: Path, source: str, waits: bool) -> None:
    file, tier = tree / "good.json", TIERS["custom"]
    record.good(tier, file, tree)
    (tree / "csrc" / source).write_text("after")
    assert bool(record.unchanged_since(tier, file, tree)) == waits


@pytest.mark.parametrize(("name", "waits"), [("custom", True), ("remote", False)])
def test_a_board_has_cases_of_its_own(tree: Path, name: str, waits: bool) -> None:
    file = tree / "good.json"
    record.good(TIERS[name], file, tree)
    (tree / "tests/vm/remote/file.c").write_text("after")
    assert bool(record.unchanged_since(TIERS[name], file, tree)) == waits


def test_one_that_runs_each_time_is_not_noted(tree: Path) -> None:
    record.good(TIERS["stock"], tree / "good.json", tree)
    assert not (tree / "good.json").exists()


def test_a_run_with_other_modules_says_nothing_of_the_tree(tree: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CM_VM_KMOD", "/elsewhere")
    record.good(TIERS["custom"], tree / "good.json", tree)
    assert not (tree / "good.json").exists()
