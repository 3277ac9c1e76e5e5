# SPDX-License-Identifier: Apache-2.0
"""docs/schema.md and schema-keys.md agree with the code."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from scripts import script
from test_schema_errors import CASES, MODE_CASES

import cm.schema

ROOT = Path(__file__).parents[3]
PAGE = ROOT / "docs" / "schema.md"


@pytest.mark.parametrize("page", ["schema-keys.md", "build-keys.md"])
def test_the_tables_of_keys_are_those_of_the_json_schema(page: str) -> None:
    assert script("docs/schema_tables.py").page(page) == (ROOT / "docs" / page).read_text(), (
        "run: python docs/schema_tables.py"
    )


def test_every_definition_has_a_table() -> None:
    sections = script("docs/schema_tables.py").SECTIONS["schema-keys.md"][1]
    definitions = {f"definitions/{name}" for name in cm.schema.json_schema()["definitions"]}
    assert definitions - {*sections.values()} == {"definitions/name", "definitions/stream_override"}


def examples() -> list[str]:
    return re.findall(r"```yaml\n(.*?)```", PAGE.read_text(), re.DOTALL)


@pytest.mark.parametrize("text", examples(), ids=lambda text: text.split("name: ")[1].split()[0])
def test_the_examples_load(text: str) -> None:
    assert cm.schema.loads(text).modes


def codes() -> set[str]:
    """The codes in the page's list: what stands in brackets explains them."""
    listed = PAGE.read_text().split("## Error codes")[1].split("\n## ")[0]
    lines = re.findall(r"^- \*\*.*", listed, re.MULTILINE)
    return set(re.findall(r"`([a-z_]+)`", re.sub(r"\([^)]*\)", "", "".join(lines))))


def test_the_list_of_codes_has_every_code_that_a_mistake_is_tested_to_give() -> None:
    assert {case[1] for case in (*CASES, *MODE_CASES)} <= codes()


def test_the_list_of_codes_has_no_code_that_does_not_exist() -> None:
    sources = "".join(file.read_text() for file in (ROOT / "cm" / "schema").glob("*.py"))
    assert [code for code in sorted(codes()) if f'"{code}"' not in sources] == []
