# SPDX-License-Identifier: Apache-2.0
"""The validator that setup.py generates agrees with the one compiled at run time."""

from __future__ import annotations

import re
import sys
from importlib import resources
from types import ModuleType

import pytest

from cm.schema import compiled, loads
from cm.schema.loader import SchemaError
from cm.schema.schema_forms import for_values
from cm.schema.structure import SCHEMA_FILE

CAMERA = resources.files("cm").joinpath("data/camera/camera.yaml").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def generated() -> ModuleType:
    module = ModuleType("cm.schema._validator")
    exec(compiled.source(SCHEMA_FILE.read_bytes()), module.__dict__)
    return module


def test_it_was_made_from_the_present_schema(generated: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cm.schema._validator", generated)
    text = SCHEMA_FILE.read_bytes()
    assert compiled.ready(text) is generated.validate
    assert compiled.ready(text + b"\n") is None


def test_schemas_are_validated_without_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cm.schema._validator", None)
    assert compiled.ready(SCHEMA_FILE.read_bytes()) is None
    assert loads(CAMERA).name == "camera"


def test_it_refuses_values_with_an_exception_of_its_own(generated: ModuleType) -> None:
    generated.validate({"config": {"name": "camera"}})
    with pytest.raises(generated.JsonSchemaValueException) as refused:
        generated.validate({"config": {"name": 3}})
    assert isinstance(refused.value, ValueError)


def test_it_holds_no_words_and_imports_nothing_that_a_manager_has_no_use_for(generated: ModuleType) -> None:
    text = compiled.source(SCHEMA_FILE.read_bytes())
    assert "must be" not in text
    assert re.findall(r"^(?:from|import) .*", text, re.MULTILINE) == ["import re"]


def test_what_is_wrong_is_reported_in_full_either_way() -> None:
    with pytest.raises(SchemaError) as refused:
        loads(CAMERA.replace("rate: 30", "rate: fast").replace("slots: 8", "slots: 0"))
    assert {problem.key.rpartition(".")[2] for problem in refused.value.problems} == {"rate", "slots"}


def test_a_condition_whose_consequence_the_walk_checks_leaves_nothing_to_generate() -> None:
    """fastjsonschema 2.16 and 2.18, those of Debian 12 and of scarthgap, write an empty branch that is not Python."""
    needs = {"if": {"not": {"required": ["a"]}}, "then": {"required": ["b"]}}
    kept = {"if": {"type": "string"}, "then": {"minLength": 2}}
    assert for_values({"type": "object", "properties": {"x": needs, "y": kept}}) == {
        "type": "object",
        "properties": {"x": {}, "y": kept},
    }
