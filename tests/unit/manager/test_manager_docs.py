# SPDX-License-Identifier: Apache-2.0
"""docs/reconfiguration.md agrees with the code."""

from __future__ import annotations

import importlib
import pkgutil
import re
from collections.abc import Iterator
from pathlib import Path

from scripts import script

import cm
from cm.errors import CmError
from cm.manager.state.steps import Step

ROOT = Path(__file__).parents[3]
PAGE = ROOT / "docs" / "reconfiguration.md"
PACKAGES = ("errors", "manager", "device", "formats.bitstream", "server", "client", "schema", "wire")


def documented() -> list[str]:
    return re.findall(r"^- `([a-z0-9_]+)`: ", PAGE.read_text(encoding="utf-8").split("\n## Errors")[1], re.MULTILINE)


def ours(module: str) -> bool:
    """Settings are read before there is anybody to send a code to."""
    among = any(f"{module}.".startswith(f"cm.{package}.") for package in PACKAGES)
    return among and not module.startswith("cm.server.settings")


def raised() -> set[str]:
    """Codes of all errors of the packages that users meet, and those that stand alone in an ErrorInfo."""
    for module in pkgutil.walk_packages(cm.__path__, "cm."):
        if ours(module.name):
            importlib.import_module(module.name)
    codes = {kind.code for kind in kinds(CmError) if ours(kind.__module__)}  # not those of tests that ran here earlier
    for package in PACKAGES:
        for path in (ROOT / "cm").joinpath(*package.split(".")).rglob("*.py"):
            codes |= set(re.findall(r'ErrorInfo\(\s*"([a-z0-9_]+)"', path.read_text(encoding="utf-8")))
    return codes


def kinds(base: type[CmError]) -> Iterator[type[CmError]]:
    yield base
    for kind in base.__subclasses__():
        yield from kinds(kind)


def test_the_diagram_is_that_of_the_state_table() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert script("docs/reconfiguration_tables.py").page(text) == text, "run: python docs/reconfiguration_tables.py"
    assert "stateDiagram-v2" in text


def test_every_code_is_listed_once_and_in_order() -> None:
    codes = documented()
    assert sorted(raised() - set(codes)) == []
    assert sorted(set(codes) - raised()) == []
    assert codes == sorted(codes)


def test_every_kind_of_step_is_described() -> None:
    table = PAGE.read_text(encoding="utf-8").split("### When a step fails")[0]
    assert {step.kind for step in Step.__args__} == set(
        re.findall(r"^\| [a-z ]+ \| `([a-z_]+)` \|", table, re.MULTILINE)
    )
