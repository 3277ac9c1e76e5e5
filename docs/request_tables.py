# SPDX-License-Identifier: Apache-2.0
"""Write the table of requests in ``protocol.md``, from wire and server: ``python docs/request_tables.py``."""

from __future__ import annotations

from pathlib import Path

from cm.server.requests import BY_KIND
from cm.wire.request_table import ROWS, Row

PAGE = Path(__file__).parent / "protocol.md"
BEGIN = "<!-- made by docs/request_tables.py: begin -->\n"
END = "<!-- made by docs/request_tables.py: end -->\n"


def page(text: str) -> str:
    """`text` with the table made anew."""
    head, rest = text.split(BEGIN)
    return head + BEGIN + table() + END + rest.split(END)[1]


def table() -> str:
    """A row for each request."""
    rows = ["| request | topic | fields of its message, frames behind it | role |", "|---|---|---|---|"]
    return "\n".join([*rows, *map(_row, ROWS), ""])


def _row(row: Row) -> str:
    order = [field.name for field in row.message.DESCRIPTOR.fields if field.name in row.fields]
    parts = [f"**`{name}`**" if name in row.marks else f"`{name}`" for name in order]
    if row.payload:
        parts.append(f"+ data{f', unless `{row.unless}`' if row.unless else ''}")
    elif "files" in row.fields:
        parts.append("+ each of `files`")
    role = BY_KIND[row.kind].right.least.role.name.lower()
    return f"| {row.kind.__name__} | `{row.topic.decode()}` | {', '.join(parts) or 'none'} | {role} |"


if __name__ == "__main__":
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
