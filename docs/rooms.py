# SPDX-License-Identifier: Apache-2.0
"""Draw the rooms of cm/ into ``architecture.md`` from the imports themselves: ``python docs/rooms.py [--check]``.

The picture leaves out what follows from the rest: if A imports B, and B imports C, no arrow leads from A to C.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Mapping
from pathlib import Path

import grimp

PAGE = Path(__file__).parent / "architecture.md"
PACKAGE = PAGE.parents[1] / "cm"
BEGIN = "<!-- made by docs/rooms.py: begin -->\n"
END = "<!-- made by docs/rooms.py: end -->\n"

Rooms = Mapping[str, frozenset[str]]  # room → rooms of which it imports a module


def rooms() -> Rooms:
    graph = grimp.build_graph("cm", exclude_type_checking_imports=True, cache_dir=None)
    names = sorted(path.parent.name for path in PACKAGE.glob("*/__init__.py"))

    def imported(name: str) -> frozenset[str]:
        inside = {f"cm.{name}", *graph.find_descendants(f"cm.{name}")}
        modules = {of for module in inside for of in graph.find_modules_directly_imported_by(module)}
        return frozenset({of.split(".")[1] for of in modules if "." in of} & set(names) - {name})

    return {name: imported(name) for name in names}


def reached(all_rooms: Rooms, start: str) -> frozenset[str]:
    """Rooms that `start` imports, and those that these do."""
    direct = all_rooms[start]
    return direct.union(*(reached(all_rooms, room) for room in direct))


def drawn(all_rooms: Rooms) -> str:
    lines = ["```mermaid", "flowchart TD"]
    for room, direct in all_rooms.items():
        beyond = frozenset().union(*(reached(all_rooms, other) for other in direct))
        lines += [f"    {room} --> {other}" for other in sorted(direct - beyond)]
    return "\n".join([*lines, "```", ""])


def purpose(room: str) -> str:
    """The first sentence of the room's own page, its docstring."""
    text = ast.get_docstring(ast.parse((PACKAGE / room / "__init__.py").read_text(encoding="utf-8"))) or ""
    return " ".join(text.split("\n\n")[0].split())


def table(all_rooms: Rooms) -> str:
    order = sorted(all_rooms, key=lambda room: (-len(reached(all_rooms, room)), room))
    rows = [f"| `cm.{room}` | {purpose(room)} |" for room in order]
    return "\n".join(["| room | what it is for |", "|---|---|", *rows, ""])


def page(text: str) -> str:
    """`text` with the picture and the table made again."""
    head, rest = text.split(BEGIN)
    found = rooms()
    return f"{head}{BEGIN}\n{drawn(found)}\n{table(found)}\n{END}{rest.split(END)[1]}"


def main(arguments: list[str]) -> int:
    text = PAGE.read_text(encoding="utf-8")
    made = page(text)
    if "--check" in arguments:
        if made != text:
            print("docs/architecture.md shows other rooms than cm/ has: python docs/rooms.py draws them again")
        return int(made != text)
    PAGE.write_text(made, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
