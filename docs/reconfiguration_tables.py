# SPDX-License-Identifier: Apache-2.0
"""Write the diagram in ``reconfiguration.md`` from the state table: ``python docs/reconfiguration_tables.py``."""

from __future__ import annotations

from pathlib import Path

from cm.manager.state.board_state import TRANSITIONS, RegionEvent, RegionPhase, diagram

PAGE = Path(__file__).parent / "reconfiguration.md"
BEGIN = "<!-- made by docs/reconfiguration_tables.py: begin -->\n"
END = "<!-- made by docs/reconfiguration_tables.py: end -->\n"


def tables() -> str:
    """The state table, as a diagram and as a table."""
    return f"\n```mermaid\n{diagram()}```\n\n{_table()}\n"


def page(text: str) -> str:
    """`text` with the state table made anew."""
    head, rest = text.split(BEGIN)
    return head + BEGIN + tables() + END + rest.split(END)[1]


def _table() -> str:
    head = [
        "| from | " + " | ".join(f"`{event.value}`" for event in RegionEvent) + " |",
        "|---" * (len(RegionEvent) + 1) + "|",
    ]
    return "\n".join([*head, *(_row(phase) for phase in RegionPhase)])


def _row(phase: RegionPhase) -> str:
    ends = (TRANSITIONS.get((phase, event)) for event in RegionEvent)
    return f"| **{phase.value}** | " + " | ".join(end.value if end else "–" for end in ends) + " |"


if __name__ == "__main__":
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
