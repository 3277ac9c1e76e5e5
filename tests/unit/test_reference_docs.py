# SPDX-License-Identifier: Apache-2.0
"""The reference that `make docs` writes contains everything that users get, each with a docstring."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from scripts import script

griffe = pytest.importorskip("griffe", reason="needs griffe: make lint installs it")

pytestmark = pytest.mark.programs
ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def reference() -> ModuleType:
    return script("docs/reference.py")


@pytest.fixture(scope="module")
def package() -> Any:
    return griffe.load("cm", search_paths=[str(ROOT)])


def test_the_reference_has_a_page_for_each_part_with_the_signatures_of_its_names(
    reference: ModuleType, tmp_path: Path
) -> None:
    reference.write(tmp_path)
    assert {path.stem for path in tmp_path.glob("*.md")} == {*reference.PAGES, "README"}
    assert "### `Board.load`" in (tmp_path / "client.md").read_text("utf-8")


def test_everything_in_the_reference_has_a_docstring(reference: ModuleType, package: Any) -> None:
    without = [
        found.path
        for page in reference.PAGES
        for _, found in reference.public(package, page)
        if found.docstring is None
    ]
    assert without == []
