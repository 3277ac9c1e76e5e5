# SPDX-License-Identifier: Apache-2.0
"""HDL of others: modules of thirteen public repositories, with verdicts written from their sources.

`HDL=FOLDER make test SUITES=tests/corpus`: one folder below for each repository (owner+name); nothing of them is here.
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest

pytest.importorskip("pyslang", reason="needs pyslang: the extra [build] is not installed")
pytest.importorskip("tree_sitter_vhdl", reason="needs tree-sitter-vhdl: the extra [build] is not installed")

from hdl_corpus import FILES, asked, cases, judged

HDL = os.environ.get("HDL")


def test_the_verdicts_are_of_many_modules_and_few_ask() -> None:
    found = list(cases())
    assert len({(case.repository, case.top) for case in found}) == len(found) >= 150
    assert {case.repository for case in found} == FILES.keys()
    assert sum(map(asked, found)) <= 0.15 * len(found)


@pytest.mark.skipif(not HDL, reason="HDL names no folder of fetched repositories")
def test_modules_are_judged_as_by_hand() -> None:
    every = list(judged(Path(str(HDL))))
    wrong = {f"{case.repository} {case.top}": (case.wanted, said) for case, said in every if said != case.wanted}
    assert every
    assert wrong == {}
