# SPDX-License-Identifier: Apache-2.0
"""Generated files and the user's changes to them."""

from __future__ import annotations

import contextlib
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cm.design.errors import BuildError
from cm.design.generate.output_tree import MANIFEST, Tree


def test_files_are_written_and_brought_up_to_date_and_an_unchanged_one_keeps_its_time(tmp_path: Path) -> None:
    assert Tree(tmp_path).write({"a/b.txt": "one\n", "c": "one\n"}).created == ["a/b.txt", "c"]
    before = (tmp_path / "c").stat().st_mtime_ns
    done = Tree(tmp_path).write({"a/b.txt": "two\n", "c": "one\n"})
    assert (done.updated, done.unchanged) == (["a/b.txt"], ["c"])
    assert (tmp_path / "a/b.txt").read_text() == "two\n"
    assert (tmp_path / "c").stat().st_mtime_ns == before


def test_a_changed_file_is_kept_where_generation_has_nothing_new(tmp_path: Path) -> None:
    Tree(tmp_path).write({"a": "one\n"})
    (tmp_path / "a").write_text("mine\n")
    assert Tree(tmp_path).write({"a": "one\n"}).kept == ["a"]
    assert (tmp_path / "a").read_text() == "mine\n"
    assert not (tmp_path / "a.new").exists()


def test_a_conflict_leaves_the_users_file_and_is_reported_with_the_new_one_until_it_is_resolved(tmp_path: Path) -> None:
    Tree(tmp_path).write({"a": "one\n"})
    (tmp_path / "a").write_text("mine\n")
    for text in ("two\n", "three\n"):
        assert Tree(tmp_path).write({"a": text}).conflicts == ["a"]
        assert (tmp_path / "a").read_text() == "mine\n"
        assert (tmp_path / "a.new").read_text() == text
        assert (tmp_path / ".cm-orig/a").read_text() == "one\n"
    (tmp_path / "a").write_text("three\n")
    assert Tree(tmp_path).write({"a": "three\n"}).unchanged == ["a"]
    assert not (tmp_path / "a.new").exists()


def test_a_file_that_was_there_before_is_never_overwritten(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("mine\n")
    assert Tree(tmp_path).write({"a": "one\n"}).conflicts == ["a"]
    assert (tmp_path / "a").read_text() == "mine\n"


def test_files_no_longer_generated_are_removed_unless_changed(tmp_path: Path) -> None:
    Tree(tmp_path).write({"a": "one\n", "b": "one\n"})
    (tmp_path / "b").write_text("mine\n")
    done = Tree(tmp_path).write({"c": "one\n"})
    assert (done.removed, done.left) == (["a"], ["b"])
    assert not (tmp_path / "a").exists()
    assert (tmp_path / "b").read_text() == "mine\n"


def test_a_damaged_manifest_is_an_error_that_says_so(tmp_path: Path) -> None:
    (tmp_path / MANIFEST).write_text("[]")
    with pytest.raises(BuildError, match="damaged"):
        Tree(tmp_path)


@pytest.mark.parametrize("writes", range(1, 8))
def test_the_next_generation_repairs_one_that_was_killed_anywhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, writes: int
) -> None:
    """Files of the killed one are never taken for the user's, even if the input has changed again since."""
    Tree(tmp_path).write({"a": "1", "b": "1", "c": "1"})
    put, left = Tree._put, [writes]

    def killed(path: Path, data: bytes) -> None:
        left[0] -= 1
        if left[0] < 0:
            raise KeyboardInterrupt
        put(path, data)

    half = Tree(tmp_path)
    with monkeypatch.context() as patch:
        patch.setattr(Tree, "_put", staticmethod(killed))
        with pytest.raises(KeyboardInterrupt):
            half.write({"a": "2", "b": "2", "c": "2"})
    done = Tree(tmp_path).write({"a": "3", "b": "3", "c": "3"})
    assert (done.updated, done.conflicts, done.kept) == (["a", "b", "c"], [], [])
    assert [(tmp_path / name).read_text() for name in "abc"] == ["3", "3", "3"]
    assert not list(tmp_path.rglob("*.new"))


def test_a_merge_begins_from_what_was_merged_last(tmp_path: Path) -> None:
    """Deleting FILE.new marks it as merged: its contents are the base of the next conflict."""
    Tree(tmp_path).write({"a": "one\n"})
    (tmp_path / "a").write_text("one\nmine\n")
    Tree(tmp_path).write({"a": "two\n"})
    (tmp_path / "a").write_text("two\nmine\n")
    (tmp_path / "a.new").unlink()
    assert Tree(tmp_path).write({"a": "two\n"}).kept == ["a"]
    assert Tree(tmp_path).write({"a": "three\n"}).conflicts == ["a"]
    assert (tmp_path / ".cm-orig/a").read_text() == "two\n"
    assert (tmp_path / "a.new").read_text() == "three\n"


def test_a_new_file_that_the_user_changed_is_moved_and_not_lost(tmp_path: Path) -> None:
    Tree(tmp_path).write({"a": "one\n"})
    (tmp_path / "a").write_text("mine\n")
    Tree(tmp_path).write({"a": "two\n"})
    (tmp_path / "a.new").write_text("half merged\n")
    Tree(tmp_path).write({"a": "three\n"})
    assert (tmp_path / "a.new").read_text() == "three\n"
    assert (tmp_path / "a.new.1").read_text() == "half merged\n"


def test_outdated_files_are_those_that_would_be_generated_differently(tmp_path: Path) -> None:
    Tree(tmp_path).write({"a": "one\n", "b": "one\n", "c": "one\n"})
    (tmp_path / "a").write_text("mine\n")
    assert Tree(tmp_path).behind({"a": "one\n", "b": "two\n", "d": "one\n"}) == ["b", "c", "d"]


EDITS = st.lists(
    st.one_of(
        st.tuples(st.just("generate"), st.sampled_from("ABC"), st.integers(0, 12)),
        st.tuples(st.just("edit"), st.sampled_from(["x", "y/z", "x.new", "y/z.new", "x.new.1"])),
        st.tuples(st.just("delete"), st.sampled_from(["x", "x.new"])),
    ),
    max_size=12,
)


@given(EDITS)
@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_nothing_that_the_user_wrote_is_ever_lost(tmp_path_factory: pytest.TempPathFactory, edits: list) -> None:
    """Generations, also killed ones, between edits: a user's text disappears only when the user replaces it."""
    folder = tmp_path_factory.mktemp("tree")
    mine: set[str] = set()
    for number, edit in enumerate(edits):
        if edit[0] == "generate":
            _generate(folder, {"x": f"{edit[1]}x", "y/z": f"{edit[1]}z", f"only {edit[1]}": "w"}, edit[2])
        else:
            path = folder / edit[1]
            mine -= {path.read_text()} if path.exists() else set()
            if edit[0] == "delete":
                path.unlink(missing_ok=True)
                continue
            path.parent.mkdir(exist_ok=True)
            path.write_text(f"user {number}")
            mine.add(f"user {number}")
        held = {path.read_text() for path in folder.rglob("*") if path.is_file()}
        assert mine <= held
    _generate(folder, {"x": "last", "y/z": "last"}, 99)
    assert not list(folder.glob("only ?"))
    for name in ("x", "y/z"):
        text = (folder / name).read_text()
        assert text == "last" or (text in mine and (folder / f"{name}.new").read_text() == "last")


def _generate(folder: Path, files: dict[str, str], writes: int) -> None:
    """A generation that is killed after some files."""

    class Killed(Tree):
        left = writes

        @staticmethod
        def _put(path: Path, data: bytes) -> None:
            Killed.left -= 1
            if Killed.left < 0:
                raise KeyboardInterrupt
            Tree._put(path, data)

    with contextlib.suppress(KeyboardInterrupt):
        Killed(folder).write(files)
