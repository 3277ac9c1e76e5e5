# SPDX-License-Identifier: Apache-2.0
"""Templates → text. One template per kind of file, in `templates/`; the same input gives the same bytes."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from cm.build.errors import MissingTool

TEMPLATES = Path(__file__).parent / "templates"


class Renderer:
    """The template engine for one output folder; paths in files are relative to `base` by ``$cm_source``."""

    def __init__(self, base: Path, out: Path, banner: str) -> None:
        try:
            import jinja2  # of the extra `build`
        except ImportError:
            raise MissingTool("generating files needs Jinja2: pip install 'fpga-cm[build]'") from None
        self._base, self._banner = base, banner
        self._environment = jinja2.Environment(
            loader=jinja2.FileSystemLoader(TEMPLATES),
            undefined=jinja2.StrictUndefined,
            trim_blocks=True,
            lstrip_blocks=True,
            keep_trailing_newline=True,
            autoescape=False,  # Tcl, Verilog and such, escaped by the filters below
        )
        self._environment.filters |= {
            "tcl": self._tcl,
            "tcl_list": lambda words: f"[list {' '.join(self._tcl(word) for word in words)}]",
            "hex": lambda value: f"{value:#x}",
            "hex8": lambda value: f"0x{value:08X}",
            "comment": comment,
            "c_name": c_name,
            "yaml": yaml_text,
        }
        self._out = out

    def render(self, template: str, context: Mapping[str, Any]) -> str:
        """The text of `template`; exactly one newline at its end."""
        text = self._environment.get_template(template).render(banner=self._banner, **context)
        return text.rstrip("\n") + "\n"

    def relative(self, path: Path) -> str:
        """`path` as seen from the output folder."""
        return Path(os.path.relpath(path, self._out)).as_posix()

    def _tcl(self, word: object) -> str:
        """One word of Tcl: a path below the project's folder by ``$cm_source``, anything else as it is."""
        if isinstance(word, Path):
            if word.is_relative_to(self._out):
                return tcl_word(word.relative_to(self._out).as_posix())
            relative = Path(os.path.relpath(word, self._base)).as_posix()
            return f'"$cm_source/{tcl_escape(relative)}"'
        return tcl_word(str(word))


def tcl_escape(text: str) -> str:
    """`text` inside double quotes of Tcl."""
    return re.sub(r'([\\"$\[\]{}])', r"\\\1", text).replace("\n", "\\n")


def tcl_word(text: str) -> str:
    """`text` as one word of Tcl: bare where nothing in it means anything."""
    if re.fullmatch(r"[A-Za-z0-9_./:+=,@%~-]+", text):
        return text
    return f'"{tcl_escape(text)}"'


def comment(text: str, prefix: str = "# ", width: int = 100) -> str:
    """`text` as comment lines."""
    words, lines, line = text.split(), [], ""
    for word in words:
        if line and len(line) + 1 + len(word) > width:
            lines.append(line)
            line = word
        else:
            line = f"{line} {word}".strip()
    return "\n".join(prefix + each for each in [*lines, line] if each)


def c_name(text: str) -> str:
    """`text` as an upper-case identifier of C."""
    name = re.sub(r"\W", "_", text).upper()
    return name if not name[:1].isdigit() else f"_{name}"


def yaml_text(value: object) -> str:
    """A value as YAML on one line, quoted where it has to be."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (int, float)):
        return str(value)
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(yaml_text(item) for item in value)}]"
    text = str(value)
    plain = re.fullmatch(r"[A-Za-z_][\w ./()+^-]*", text) and not text.endswith(" ")
    if plain and text.lower() not in ("true", "false", "null", "yes", "no", "on", "off", "y", "n"):
        return text
    escaped = text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
    return f'"{escaped}"'


def by_language(paths: Iterable[Path]) -> dict[str, list[Path]]:
    """Sources sorted into the reading commands of the vendor's tool."""
    kinds = {".sv": "systemverilog", ".svh": "header", ".vh": "header", ".h": "header", ".inc": "header"}
    kinds |= {".vhd": "vhdl", ".vhdl": "vhdl"}
    found: dict[str, list[Path]] = {"verilog": [], "systemverilog": [], "vhdl": [], "header": []}
    for path in paths:
        found[kinds.get(path.suffix.lower(), "verilog")].append(path)
    return found
