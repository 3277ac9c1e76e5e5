# SPDX-License-Identifier: Apache-2.0
"""Renders templates, one per kind of file, in `templates/`; the same input gives the same bytes."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

from cm.design.errors import MissingTool
from cm.extras import installing

TEMPLATES = Path(__file__).parent / "templates"


@lru_cache(maxsize=1)
def _environment() -> Any:
    """The templates, compiled when they are first used, since that takes longer than all rendering."""
    try:
        import jinja2  # of the extra `build`
    except ImportError:
        raise MissingTool(f"generating files needs Jinja2: {installing('build')}") from None
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,  # not HTML but Tcl, Verilog and the like, which the filters below escape
    )

    @jinja2.pass_context
    def tcl(context: Any, word: object) -> str:
        renderer: Renderer = context["renderer"]
        return renderer.tcl(word)

    @jinja2.pass_context
    def tcl_list(context: Any, words: Iterable[object]) -> str:
        return f"[list {' '.join(tcl(context, word) for word in words)}]"

    environment.filters |= {
        "tcl": tcl,
        "tcl_list": tcl_list,
        "hex": lambda value: f"{value:#x}",
        "hex8": lambda value: f"0x{value:08X}",
        "c_name": c_name,
        "yaml": yaml_text,
    }
    return environment


class Renderer:
    """Renders templates for one output folder; in files, paths below `base` are written with ``$cm_source``."""

    def __init__(self, base: Path, out: Path, banner: str) -> None:
        self._base, self._out, self._banner = base, out, banner
        self._environment = _environment()

    def render(self, template: str, context: Mapping[str, Any]) -> str:
        """Return the text of `template`, with exactly one newline at its end."""
        given = {"renderer": self, "banner": self._banner, **context}
        text: str = self._environment.get_template(template).render(given)
        return text.rstrip("\n") + "\n"

    def relative(self, path: Path) -> str:
        """`path` as seen from the output folder."""
        return Path(os.path.relpath(path, self._out)).as_posix()

    def tcl(self, word: object) -> str:
        """Write one word of Tcl: a path below the project's folder with ``$cm_source``, anything else unchanged."""
        if isinstance(word, Path):
            if word.is_relative_to(self._out):
                return tcl_word(word.relative_to(self._out).as_posix())
            relative = Path(os.path.relpath(word, self._base)).as_posix()
            return f'"$cm_source/{tcl_escape(relative)}"'
        return tcl_word(str(word))


def tcl_escape(text: str) -> str:
    """Escape `text` for use inside double quotes in Tcl."""
    return re.sub(r'([\\"$\[\]{}])', r"\\\1", text).replace("\n", "\\n")


def tcl_word(text: str) -> str:
    """Write `text` as one word of Tcl: bare if it has no special characters."""
    if re.fullmatch(r"[A-Za-z0-9_./:+=,@%~-]+", text):
        return text
    return f'"{tcl_escape(text)}"'


def c_name(text: str) -> str:
    """Convert `text` to an upper-case C identifier."""
    name = re.sub(r"\W", "_", text).upper()
    return name if not name[:1].isdigit() else f"_{name}"


def yaml_text(value: object) -> str:
    """Write a value as YAML on one line, quoted if necessary."""
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
    """Group sources by the command with which the vendor's tool reads them."""
    kinds = {".sv": "systemverilog", ".svh": "header", ".vh": "header", ".h": "header", ".inc": "header"}
    kinds |= {".vhd": "vhdl", ".vhdl": "vhdl"}
    found: dict[str, list[Path]] = {"verilog": [], "systemverilog": [], "vhdl": [], "header": []}
    for path in paths:
        found[kinds.get(path.suffix.lower(), "verilog")].append(path)
    return found
