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
            lines = fields(path.read_text("utf-8"))
            rows += [f'            "{line}{chr(92)}n"\n' for line in lines[:-1]] + [f'            "{lines[-1]}"\n']
            rows.append("        ),\n")
    return HEAD + "".join(rows) + "    }\n)\n"


def fields(text: str) -> list[str]:
    """Fields and dividers."""
    lines = [line.partition("#")[0].strip() for line in text.splitlines()]
    return [" ".join(line.split()) for line in lines if line == "---" or FIELD.match(line)]


if __name__ == "__main__":
    TARGET.write_text(module(), encoding="utf-8")
