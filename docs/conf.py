# SPDX-License-Identifier: Apache-2.0
"""The site of these pages: ``make docs`` (Sphinx, MyST, Furo; docs/decisions/the-site.md says why)."""

from __future__ import annotations

import os
import re
import shutil
import sys
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.ext.graphviz import graphviz
from sphinx.transforms import SphinxTransform

HERE = Path(__file__).parent
REPOSITORY = HERE.parent
sys.path[:0] = [str(HERE), str(REPOSITORY / "release"), str(REPOSITORY)]
MADE = HERE / "reference"  # pages that are not kept: of docstrings, the parser, the settings' schema, the messages
READMES = ("clients/node", "clients/go", "yocto/meta-cm")  # which belong into the site too

project = "fpga-cm"
author = "fpga-cm maintainers"
release = re.findall(r'__version__ = "(.+)"', (REPOSITORY / "cm/_version.py").read_text())[0]
version = release
extensions = ["myst_parser", "sphinx.ext.graphviz"]
exclude_patterns = ["examples", "boards/loop", "notebooks/*.ipynb", "prose"]
suppress_warnings = ["misc.highlighting_failure"]  # Listing 1 as printed, lines of consoles with …
myst_heading_anchors = 4
myst_enable_extensions = ["deflist"]
html_theme = "furo"
html_title = f"fpga-cm {release}"
html_static_path = ["_site"]
html_css_files = ["site.css"]
html_js_files = ["versions.js"]
html_show_sphinx = False
html_show_copyright = False  # the licence is in the sources
html_copy_source = False
html_theme_options = {"navigation_with_keys": True, "top_of_page_buttons": []}
graphviz_output_format = "svg"
_ALSO = {"configuration", "region", "mode", "static part", "footprint", "register window", "lease", "slot", "role"}
_ALSO |= {"data socket", "guest", "generation", "decouple", "quiesce", "upset", "scrub", "boundary", "keeper"}
_ARROW = re.compile(r"\s*(\S+) -->(?:\|(.*)\|)? ([^\s:]+)(?:: (.*))?$")
_BOX = re.compile(r'\s*(subgraph )?(\w+)\["(.*)"\]$')
_OUTSIDE = re.compile(r"\[((?:`[^`]*`|[^\[\]`\n])*)\]\(((?:\.\./)+[^)#\s]+)(#[^)\s]*)?\)")
_LINK = re.compile(r"\[((?:`[^`]*`|[^\[\]`\n])*)\]\((?!\w+:)([^)#\s]+)(#[^)\s]*)?\)")


def drawn(mermaid: str) -> str:
    """The boxes and arrows of a Mermaid diagram, which GitHub draws, as a graph for dot."""
    style = 'node [shape=box, style="rounded", fontname="sans-serif"]; edge [fontname="sans-serif", fontsize=10];'
    kind, *lines = mermaid.splitlines()
    said = ["rankdir=LR;" if kind == "flowchart LR" else "", 'fontname="sans-serif";', style]
    for line in lines:
        if arrow := _ARROW.match(line):
            start, inside, end, after = arrow.groups()
            said.append(f'"{start}" -> "{end}" [label="{inside or after or ""}"];'.replace("[*]", " "))
        elif box := _BOX.match(line):
            group, name, text = box.groups()
            said.append(f'subgraph "cluster_{name}" {{ label="{text}";' if group else f'"{name}" [label="{text}"];')
        elif line.strip() == "end":
            said.append("}")
        else:
            raise ValueError(f"a {kind} has a line that the site does not draw: {line}")
    return f"digraph {{ bgcolor=transparent; {' '.join(said)} }}"


def terms(glossary: str) -> dict[str, str]:
    """Words of the glossary that pages link where they first stand, and their anchors: hardware's, and `_ALSO`."""
    hardware = glossary.partition("**hardware and kernel**")[2].partition("| **")[0]
    rows = re.findall(r"^\| ([^|*-][^|*]*?) \|", glossary, re.MULTILINE)
    words = {word.strip(): row for row in reversed(rows) for word in row.split(",")}
    return {
        word: f"term-{nodes.make_id(row)}" for word, row in words.items() if word in _ALSO or f"| {row} |" in hardware
    }


class Words(SphinxTransform):
    """Link words of the glossary where they first stand on a page, and make the rows to link to."""

    default_priority = 900  # after references are known: a word within a link stays

    def apply(self, **_kwargs: Any) -> None:
        page = self.env.docname
        wanted = terms((HERE / "glossary.md").read_text("utf-8"))
        if page == "glossary":
            rows = {f"term-{nodes.make_id(row[0].astext())}": row for row in self.document.findall(nodes.row)}
            for anchor in wanted.values():
                rows[anchor]["ids"] = [anchor]
        elif not page.startswith("reference/"):
            for word, anchor in wanted.items():
                self.link(word, anchor)

    def link(self, word: str, anchor: str) -> None:
        """The first that stands in text, or is a literal of its own, and not in a heading, a block or a link."""
        found = re.compile(rf"(?<![\w/.-]){re.escape(word)}s?(?![\w/-])")
        for text in self.document.findall(nodes.Text):
            at = found.search(text.astext())
            if at is None or _within(text, (nodes.title, nodes.reference, nodes.literal_block, nodes.pending)):
                continue
            literal = isinstance(text.parent, nodes.literal)
            if literal and found.fullmatch(text.astext()) is None:
                continue
            place = text.parent if literal else text
            uri = f"{os.path.relpath(HERE / 'glossary', (HERE / self.env.docname).parent)}.html#{anchor}"
            link = nodes.reference("", "", refuri=uri, classes=["term"], internal=True)
            link += place.deepcopy() if literal else nodes.Text(at[0])
            before, after = ("", "") if literal else (text[: at.start()], text[at.end() :])
            place.parent.replace(
                place, [*map(nodes.Text, filter(None, [before])), link, *map(nodes.Text, filter(None, [after]))]
            )
            return


def _within(node: nodes.Node, kinds: tuple[type[nodes.Node], ...]) -> bool:
    while (node := node.parent) is not None:
        if isinstance(node, kinds):
            return True
    return False


class Diagrams(SphinxTransform):
    """Draw what is between ```mermaid and ```, where there is dot; elsewhere it stays text."""

    default_priority = 10

    def apply(self, **_kwargs: Any) -> None:
        if shutil.which("dot") is None:
            return
        for block in list(self.document.findall(nodes.literal_block)):
            if block.get("language") == "mermaid":
                block.replace_self(graphviz("", code=drawn(block.astext()), options={"docname": self.env.docname}))


def make_pages(_app: Sphinx) -> None:
    """Write the pages that are made, where they are not yet as they should be."""
    import manpages
    import reference

    texts = dict(reference.pages())
    texts |= {f"{page.file}.md": manpages.markdown(page) for page in manpages.pages()}
    texts["messages.proto.md"] = "# Messages\n\nAll that goes over the wire; [the protocol](../protocol.md).\n\n"
    texts["messages.proto.md"] += f"```protobuf\n{(REPOSITORY / 'cm/wire/cm.proto').read_text('utf-8')}```\n"
    texts |= {_readme(name).name: (REPOSITORY / name / "README.md").read_text("utf-8") for name in READMES}
    MADE.mkdir(exist_ok=True)
    for old in {path.name for path in MADE.iterdir()} - texts.keys():
        (MADE / old).unlink()
    for name, text in texts.items():
        path = MADE / name
        if not path.exists() or path.read_text("utf-8") != text:
            path.write_text(text, "utf-8")


def _readme(folder: str) -> Path:
    return MADE / f"{folder.replace('/', '-')}.md"


def outside(_app: Sphinx, docname: str, source: list[str]) -> None:
    """Links out of docs/: to a README that is a page here, else to a copy of the file, else no link."""
    origin = next((name for name in READMES if _readme(name).stem == docname.removeprefix("reference/")), None)
    folder = REPOSITORY / origin if origin else (HERE / docname).parent

    def put(found: re.Match[str]) -> str:
        target = (folder / found[2]).resolve()
        if target.parent.relative_to(REPOSITORY).as_posix() in READMES and target.name == "README.md":
            target = _readme(target.parent.relative_to(REPOSITORY).as_posix())
        elif not target.is_file() or (target.suffix == ".md" and not target.is_relative_to(HERE)):
            return found[1]  # the text alone: the sources have it
        return f"[{found[1]}]({os.path.relpath(target, (HERE / docname).parent)}{found[3] or ''})"

    source[0] = _LINK.sub(put, source[0]) if origin else _OUTSIDE.sub(put, source[0])


def setup(app: Sphinx) -> None:
    app.add_transform(Diagrams)
    app.add_transform(Words)
    app.connect("builder-inited", make_pages)
    app.connect("source-read", outside)
