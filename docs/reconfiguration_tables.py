# SPDX-License-Identifier: Apache-2.0
"""Write the diagram in ``reconfiguration.md`` from the state table: ``python docs/reconfiguration_tables.py``."""

from __future__ import annotations

from pathlib import Path

from cm.manager.state.board_state import diagram

PAGE = Path(__file__).parent / "reconfiguration.md"
BEGIN = "<!-- made by docs/reconfiguration_tables.py: begin -->\n"
END = "<!-- made by docs/reconfiguration_tables.py: end -->\n"


def tables() -> str:
    """The state table as a diagram."""
    return f"\n```mermaid\n{diagram()}```\n\n"


def page(text: str) -> str:
    """`text` with the diagram made again."""
    head, rest = text.split(BEGIN)
    return head + BEGIN + tables() + END + rest.split(END)[1]


if __name__ == "__main__":
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
