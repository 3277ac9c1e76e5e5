# SPDX-License-Identifier: Apache-2.0
"""What is generated for the shipped examples, byte for byte (`python tests/golden/update.py` writes it anew)."""

from __future__ import annotations

from pathlib import Path

import pytest
from build_support import EXAMPLES, GOLDEN, NAMES, SHIPPED, copy_examples, generated


def tree(folder: Path) -> dict[str, bytes]:
    found = {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    return {name: data for name, data in found.items() if not name.startswith((".", "hdl/lib/"))}


@pytest.mark.parametrize("name", NAMES)
def test_an_example_generates_its_golden_files(name: str, tmp_path: Path) -> None:
    _, out = generated(copy_examples(tmp_path), name)
    have, want = tree(out), tree(GOLDEN / name)
    assert sorted(have) == sorted(want)
    for path, data in want.items():
        assert have[path].decode() == data.decode(), path


def test_the_demo_runs_what_is_generated_from_the_example(tmp_path: Path) -> None:
    _, out = generated(copy_examples(tmp_path), "camera")
    assert (EXAMPLES / "camera" / SHIPPED).read_text() == (out / SHIPPED).read_text()


def test_no_generated_file_names_the_folder_it_was_made_in(tmp_path: Path) -> None:
    _, out = generated(copy_examples(tmp_path), "camera")
    assert not [name for name, data in tree(out).items() if str(tmp_path).encode() in data]


def test_every_generated_file_has_an_spdx_line(tmp_path: Path) -> None:
    _, out = generated(copy_examples(tmp_path), "two_regions")
    plain = ("inputs/", "steps.json", "petalinux/user-rootfsconfig")
    missing = [n for n, d in tree(out).items() if b"SPDX-License-Identifier" not in d and not n.startswith(plain)]
    assert not missing
