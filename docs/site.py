# SPDX-License-Identifier: Apache-2.0
"""Build the site into a folder of this version beside those of others: ``python docs/site.py [FOLDER]``.

Every warning of Sphinx is an error: a link to nothing, a page that no door leads to. Nothing is fetched, when it is
built and when it is read.
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

from sphinx.cmd.build import build_main

DOCS = Path(__file__).parent
_FIRST = (
    '<!doctype html><meta charset="utf-8"><title>fpga-cm</title><meta http-equiv="refresh" content="0; url={0}">'
    '<a href="{0}">fpga-cm</a>\n'
)


def newest_first(root: Path) -> list[str]:
    """The versions that are there."""
    names = [page.parent.name for page in root.glob("*/index.html")]
    return sorted(names, key=lambda name: [int(part) for part in re.findall(r"\d+", name)], reverse=True)


def from_elsewhere(folder: Path) -> list[str]:
    """Pages that would load a script, a font or a style from another server."""
    loads = re.compile(
        r"<(?:script|img|iframe|source)\b[^>]*\bsrc=[\"'](?:https?:)?//|<link\b[^>]*\bhref=[\"'](?:https?:)?//"
    )
    styles = re.compile(r"url\(\s*[\"']?(?:https?:)?//|@import\s+[\"'](?:https?:)?//")
    found = [path for path in folder.rglob("*.html") if loads.search(path.read_text("utf-8"))]
    found += [path for path in folder.rglob("*.css") if styles.search(path.read_text("utf-8"))]
    return [str(path.relative_to(folder)) for path in found]


def main(arguments: list[str]) -> int:
    root = Path(arguments[0]) if arguments else DOCS.parent / "build" / "site"
    version = re.findall(r'__version__ = "(.+)"', (DOCS.parent / "cm/_version.py").read_text("utf-8"))[0]
    out = root / version
    cache = str(root.parent / "site-cache")
    options = ["-b", "html", "-q", "-W", "--keep-going", "-j", "auto", "-d", cache]
    status = build_main([*options, str(DOCS), str(out)])
    if status == 0 and (away := from_elsewhere(out)):
        print("these pages load something from another server:", *away, sep="\n")
        status = 1
    if status == 0:
        names = newest_first(root)
        (root / "versions.list.js").write_text(f"window.FPGA_CM_VERSIONS = {json.dumps(names)};\n", "utf-8")
        (root / "index.html").write_text(_FIRST.format(f"{names[0]}/index.html"), "utf-8")
        print(f"{root / 'index.html'}: {len(list(out.rglob('*.html')))} pages")
    return status


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
