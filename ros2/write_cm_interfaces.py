# SPDX-License-Identifier: Apache-2.0
"""Write ``cm/networks/rmw_zenoh/cm_interfaces.py`` from cm_interfaces: ``python ros2/write_cm_interfaces.py``."""

from __future__ import annotations

import re
from pathlib import Path

HERE = Path(__file__).resolve().parent
TARGET = HERE.parent / "cm" / "networks" / "rmw_zenoh" / "cm_interfaces.py"
HEAD = '''\
# SPDX-License-Identifier: Apache-2.0
"""ros2/cm_interfaces without comments and constants; ``python ros2/write_cm_interfaces.py`` writes it."""

from __future__ import annotations

from types import MappingProxyType

OWN = MappingProxyType(
    {
'''
FIELD = re.compile(r"^([\w/<=\[\]]+) +(\w+)$")


def module() -> str:
    """The text of the module."""
    rows = []
    for kind in ("msg", "srv", "action"):
        for path in sorted((HERE / "cm_interfaces" / kind).iterdir()):
            rows.append(f'        "cm_interfaces/{kind}/{path.stem}": (\n')
            rows += [f'            "{line}"\n' for line in packed(fields(path.read_text("utf-8")))]
            rows.append("        ),\n")
    return HEAD + "".join(rows) + "    }\n)\n"


def packed(lines: list[str]) -> list[str]:
    """As many fields on a line as fit, each but the last with a line's end, escaped."""
    rows = [""]
    for line in lines:
        if len(rows[-1]) + len(line) > 100:
            rows.append("")
        rows[-1] += rf"{line}\n"
    rows[-1] = rows[-1].removesuffix(r"\n")
    return rows


def fields(text: str) -> list[str]:
    """Fields and dividers."""
    lines = [line.partition("#")[0].strip() for line in text.splitlines()]
    return [" ".join(line.split()) for line in lines if line == "---" or FIELD.match(line)]


if __name__ == "__main__":
    TARGET.write_text(module(), encoding="utf-8")
