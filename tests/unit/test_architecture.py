# SPDX-License-Identifier: Apache-2.0
"""docs/architecture.md and docs/maps.md list the packages and modules that exist, in order."""

from __future__ import annotations

import importlib.util
import re

import pytest
from test_imports import GRAPH, MAY, PACKAGE

DOCS = PACKAGE.parent / "docs"
ARCHITECTURE = DOCS / "architecture.md"


def section(title: str) -> str:
    text = ARCHITECTURE.read_text("utf-8")
    found = re.search(rf"^## {re.escape(title)}\n(.*?)(?=^## |\Z)", text, re.MULTILINE | re.DOTALL)
    assert found, f"docs/architecture.md has no section {title!r}"
    return found[1]


def rows(text: str) -> list[list[str]]:
    """The names in the first cell of each row."""
    cells = re.findall(r"^\| (`[^|]*) \|", text, re.MULTILINE)
    return [re.findall(r"`([\w.]+)`", cell) for cell in cells]


def test_the_page_names_every_package_and_their_order_holds() -> None:
    text = section("The path of a request")
    named = {name.removeprefix("cm.") for row in rows(text) for name in row}
    assert named == GRAPH.children("cm") - {"__main__", "_version"}
    order = re.search(r"^Order of imports[^:]*: (.*)\.$", text, re.MULTILINE)
    assert order
    packages = re.split(r", | \| ", order[1])
    for place, package in enumerate(packages):
        later = set(packages[place + 1 :])
        assert not MAY.get(package, set()) & later, package
    assert {name.split(".")[0] for name in packages} == named


FLOORS = {
    "cm.manager": "The manager (`cm.manager`)",
    "cm.daemon": "The daemon (`cm.daemon`)",
    "cm.sim": "The simulator (`cm.sim`)",
    "cm.build": "The build tool (`cm.build`)",
}


@pytest.mark.parametrize("package", FLOORS)
def test_in_a_package_imports_run_from_the_top_of_its_table_downwards(package: str) -> None:
    floors = rows(section(FLOORS[package]))
    floor = {name: number for number, names in enumerate(floors) for name in names}
    assert floor.keys() == GRAPH.children(package) - {"__main__"}
    up = {
        f"{a} imports {b}" for a, of in GRAPH.between(package).items() for b in of if a in floor and floor[b] < floor[a]
    }
    assert not up


def test_the_maps_are_those_of_the_source() -> None:
    spec = importlib.util.spec_from_file_location("maps", DOCS / "maps.py")
    assert spec is not None
    assert spec.loader is not None
    maps = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(maps)
    assert maps.PAGE.read_text("utf-8") == maps.page(), "python docs/maps.py writes docs/maps.md anew"
