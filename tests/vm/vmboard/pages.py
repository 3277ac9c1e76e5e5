# SPDX-License-Identifier: Apache-2.0
"""What the pages tell a board's owner to type, for boards where it is typed."""

from __future__ import annotations

import re

from vmboard.paths import REPOSITORY


def documented(page: str, marker: str) -> str:
    """The block of a page in which `marker` stands: commands, or lines of settings."""
    text = (REPOSITORY / page).read_text()
    blocks = re.findall(r"^```(?:sh|yaml)\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    blocks += re.findall(r"(?:^ {4}.*\n)+", text, re.MULTILINE)
    found = [block for block in blocks if marker in block]
    assert len(found) == 1, f"{page} has {len(found)} blocks with {marker!r}"
    return "\n".join(line.removeprefix("    ") for line in found[0].splitlines()) + "\n"
