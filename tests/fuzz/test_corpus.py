# SPDX-License-Identifier: Apache-2.0
"""What the fuzzers start from and have found is read as documented, by every target (`make fuzz` looks further)."""

from __future__ import annotations

import importlib
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))
TARGETS = sorted(path.stem for path in (HERE / "targets").glob("[a-z]*.py"))


@pytest.fixture(scope="module", autouse=True)
def _scratch(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """The targets make a folder when they are imported, for as long as the process lasts."""
    before, tempfile.tempdir = tempfile.tempdir, str(tmp_path_factory.mktemp("f"))
    yield
    tempfile.tempdir = before


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.networks if name == "fleet" else ()) for name in TARGETS]
)
def test_what_is_known_is_read_or_refused(name: str) -> None:
    target = importlib.import_module(f"targets.{name}")
    inputs = [*target.seeds(), *(path.read_bytes() for path in sorted((HERE / "corpus" / name).glob("*")))]
    for data in [b"", *inputs]:
        target.one(data)


def test_every_corpus_has_its_target() -> None:
    assert {path.name for path in (HERE / "corpus").iterdir()} <= set(TARGETS)
