# SPDX-License-Identifier: Apache-2.0
"""Write ``maps.md``, a line for every module of the larger packages: ``python docs/maps.py``."""

from __future__ import annotations

import ast
import sys
from pathlib import Path

DOCS = Path(__file__).resolve().parent
PAGE = DOCS / "maps.md"
sys.path.insert(0, str(DOCS.parent / "tests"))

from import_graph import ImportGraph  # noqa: E402 (of the tests, which read imports as well)

LARGE = 10  # modules and packages directly below; a package of fewer explains itself
HEAD = """# Maps

Every package of more than ten modules, one table each, from the top of its imports downwards: a module imports
those below it, never one above. The lines are the modules' own first lines; `python docs/maps.py` writes this
page. The order of the packages among themselves is in [architecture.md](architecture.md).
"""


def page() -> str:
    """The whole page."""
    graph = ImportGraph(DOCS.parent / "cm")
    large = [name for name, path in graph.modules.items() if path.name == "__init__.py" and name != "cm"]
    return HEAD + "".join(_table(graph, name) for name in sorted(large) if len(_children(graph, name)) > LARGE)


def _children(graph: ImportGraph, package: str) -> list[str]:
    """Without what setup.py generates, and what only `python -m` runs."""
    return sorted(name for name in graph.children(package) if not name.startswith("_"))


def _table(graph: ImportGraph, package: str) -> str:
    between = graph.between(package)
    floors: dict[str, int] = {}

    def floor(name: str) -> int:
        if name not in floors:
            floors[name] = -1  # of one that is come upon again: parts that name the whole's type
            floors[name] = 1 + max((floor(below) for below in sorted(between[name])), default=-1)
        return floors[name]

    ordered = sorted(_children(graph, package), key=lambda name: (-floor(name), name))
    lines = [f"| `{name}` | {_first_line(graph, f'{package}.{name}')} |" for name in ordered]
    return f"\n## `{package}`\n\n| module | |\n|---|---|\n" + "\n".join(lines) + "\n"


def _first_line(graph: ImportGraph, module: str) -> str:
    text = ast.get_docstring(ast.parse(graph.modules[module].read_text(encoding="utf-8"))) or ""
    return text.partition("\n")[0].replace("|", "\\|")


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
