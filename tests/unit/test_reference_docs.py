# SPDX-License-Identifier: Apache-2.0
"""The reference that `make docs` writes contains everything that users get, each with a docstring."""

from __future__ import annotations

import importlib.util
import re
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

griffe = pytest.importorskip("griffe", reason="needs griffe: make lint installs it")

pytestmark = pytest.mark.programs
ROOT = Path(__file__).resolve().parents[2]

# Type aliases: named in signatures, but never created by or given to users.
SPELLINGS = {
    "Limit",
    "Key",
    "Array",
    "NDArray",
    "OnProgress",
    "AnyRoot",
    "Source",
    "Buffer",
    "Body",
    "Progress",
    "Value",
    "Writes",
}
# Names of a class's own methods that are builtins in its signatures, and what only `open` of a device makes.
INSIDE = {
    "cm.device.axidma.AxiDma names cm.device.native.call.Handle",
    "cm.device.buffer.DmaBuffer names cm.device.buffer.DmaBuffer.memoryview",
    "cm.device.overlays.Overlays names cm.device.overlays.Overlays.list",
    "cm.device.uio.Uio names cm.device.native.uio",
    "cm.schema.model.FieldAccess names cm.field_access.Kind",
    "cm.schema.model.Register names cm.field_access.Rest",
    "cm.formats.bitstream.report_cache.ReportCache names cm.formats.bitstream.report_cache.Inspected",
}


@pytest.fixture(scope="module")
def reference() -> ModuleType:
    spec = importlib.util.spec_from_file_location("reference_pages", ROOT / "docs/reference.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def package() -> Any:
    return griffe.load("cm", search_paths=[str(ROOT)])


def test_the_reference_has_a_page_for_each_part_with_the_signatures_of_its_names(
    reference: ModuleType, tmp_path: Path
) -> None:
    reference.write(tmp_path)
    assert {path.stem for path in tmp_path.glob("*.md")} == {*reference.PAGES, "README"}
    assert "### `Board.load`" in (tmp_path / "client.md").read_text("utf-8")


def annotations(reference: ModuleType, found: Any) -> Iterator[Any]:
    """The names in the public signatures of a class or function."""
    functions = [found] if found.is_function else []
    if found.is_class:
        for name, member in found.members.items():
            if member.is_attribute and not name.startswith("_") and member.annotation is not None:
                yield member.annotation
            if member.is_function and reference.is_public(name, member):
                functions.append(member)
    for function in functions:
        yield from (p.annotation for p in function.parameters if p.annotation is not None)
        if function.returns is not None:
            yield function.returns


def test_all_that_signatures_name_is_in_the_reference(reference: ModuleType, package: Any) -> None:
    shown = [found for page in reference.PAGES for _, found in reference.public(package, page)]
    paths = {found.path for found in shown}
    missing = {
        f"{found.path} names {expression.canonical_path}"
        for found in shown
        for annotation in annotations(reference, found)
        if not isinstance(annotation, str)
        for expression in annotation.iterate(flat=True)
        if isinstance(expression, griffe.ExprName)
        and expression.canonical_path.startswith("cm.")
        and expression.name not in SPELLINGS
        and not re.fullmatch(r"_?[A-Z]|Self|_T", expression.name)
        and _final(package, expression.canonical_path) not in paths
    }
    assert missing == INSIDE


def _final(package: Any, path: str) -> str:
    try:
        found = package[path.removeprefix("cm.")]
    except KeyError:
        return path
    return str(found.final_target.path if found.is_alias else found.path)


def test_everything_in_the_reference_has_a_docstring(reference: ModuleType, package: Any) -> None:
    without = [
        found.path
        for page in reference.PAGES
        for _, found in reference.public(package, page)
        if found.docstring is None
    ]
    assert without == []
