# SPDX-License-Identifier: Apache-2.0
"""Pages whose blocks need Verilator run as they stand there."""

from __future__ import annotations

from pathlib import Path

import pytest
from manager_process import REPOSITORY
from pages import read, suite

PAGES = sorted(path for path in (REPOSITORY / "docs").rglob("*.md") if suite(path.read_text("utf-8")) == "rtl")


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.stem)
def test_the_blocks_of_a_page_run_as_they_stand_there(path: Path) -> None:
    read(path.read_text("utf-8"), path.name)
