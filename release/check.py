# SPDX-License-Identifier: Apache-2.0
"""Is this tree a release?  Every finding is a line; exit status 1 if there is one.

    release/check.py [--tag v1.2.3]

Changelog, version in every place that names one, licences, links of the documentation. What takes a build
(the bytes of two folders) is `tests/release/test_backend.py`, which `make release-check` runs after this, and then
writes the bill of materials.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
_LINK = re.compile(r"\[[^\]]*\]\(([^)#\s]+)(#[^)\s]*)?\)")
_HEADING = re.compile(r"^#+ (.+)$", re.MULTILINE)


def version() -> str:
    """The version, from its one place."""
    found = re.search(r'^__version__ = "(.+)"$', (ROOT / "cm/_version.py").read_text(), re.MULTILINE)
    assert found is not None
    return found[1]


def versions() -> Iterator[tuple[str, str]]:
    """Every other place that names the version, and what it says."""
    for name, pattern in (
        ("kmod/dkms.conf", r'PACKAGE_VERSION="(.+)"'),
        ("debian/changelog", r"^fpga-cm \((.+)-\d+\)"),
    ):
        found = re.search(pattern, (ROOT / name).read_text(), re.MULTILINE)
        yield name, found[1] if found else "no version"
    for recipe in (ROOT / "yocto/meta-cm/recipes-cm/fpga-cm").glob("*.bb"):
        yield recipe.relative_to(ROOT).as_posix(), recipe.stem.split("_")[1]
    for source in (ROOT / "kmod").rglob("*.c"):
        for found_version in re.findall(r'MODULE_VERSION\("(.+)"\)', source.read_text()):
            yield source.relative_to(ROOT).as_posix(), found_version


def wrong_versions(wanted: str) -> Iterator[str]:
    """Places that name another version."""
    for name, said in versions():
        if said != wanted:
            yield f"{name}: version {said}, where cm/_version.py says {wanted}"


def changelog(wanted: str, released: bool) -> Iterator[str]:
    """A release has a section of its own; before it, what is new, if anything is, stands under Unreleased."""
    text = (ROOT / "CHANGELOG.md").read_text()
    section = rf"^## {re.escape(wanted)} - \d{{4}}-\d\d-\d\d$"
    heading = section if released or "## Unreleased" not in text else r"^## Unreleased$"
    found = re.search(heading, text, re.MULTILINE)
    if not found:
        yield f"CHANGELOG.md: no section {'## ' + wanted + ' - YYYY-MM-DD' if released else '## Unreleased'}"
    elif not re.search(r"^- ", text[found.end() :].split("\n## ")[0], re.MULTILINE):
        yield "CHANGELOG.md: the section says nothing"


def documents() -> list[Path]:
    """Every Markdown file in version control."""
    names = subprocess.run(["git", "ls-files", "*.md"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    return [ROOT / name for name in names.splitlines() if not name.startswith(("tests/golden/", "docs/prose/"))]


def broken_links(paths: list[Path]) -> Iterator[str]:
    """Links to files, or headings of them, that are not there; those to other sites are not looked at."""
    for path in paths:
        for target, anchor in _LINK.findall(_without_code(path.read_text())):
            if re.match(r"[a-z]+:", target):
                continue
            place = (path.parent / target).resolve()
            where = f"{path.relative_to(ROOT)}: link to {target}{anchor}"
            if not place.exists():
                yield f"{where}: no such file"
            elif anchor and place.suffix == ".md" and anchor[1:] not in _anchors(place):
                yield f"{where}: no such heading"


def unreachable(paths: list[Path]) -> Iterator[str]:
    """Pages of docs/ to which no link leads from the README, over any number of pages."""
    seen: set[Path] = set()
    to_read = [ROOT / "README.md"]
    while to_read:
        path = to_read.pop()
        if path in seen or path.suffix != ".md" or not path.is_file():
            continue
        seen.add(path)
        to_read += [(path.parent / target).resolve() for target, _ in _LINK.findall(_without_code(path.read_text()))]
    for path in sorted(set(paths) - seen):
        if (ROOT / "docs") in path.parents:
            yield f"{path.relative_to(ROOT)}: no link leads here from README.md"


def _without_code(text: str) -> str:
    return re.sub(r"```.*?```|`[^`\n]*`", "", text, flags=re.DOTALL)


def _anchors(path: Path) -> set[str]:
    """As hosts of repositories make them: lower case, spaces as hyphens, no other signs."""
    return {
        re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in _HEADING.findall(path.read_text())
    }


def licences() -> Iterator[str]:
    """What reuse says of a tree whose licences are not all told."""
    tool = Path(sys.executable).with_name("reuse")
    done = subprocess.run([tool, "lint", "--lines"], cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode:
        yield from (f"reuse: {line}" for line in done.stdout.splitlines())


def findings(tag: str) -> Iterator[str]:
    """Everything that is wrong."""
    wanted = version()
    if tag and tag != f"v{wanted}":
        yield f"tag {tag}, where cm/_version.py says {wanted}"
    yield from wrong_versions(wanted)
    yield from changelog(wanted, bool(tag))
    yield from broken_links(documents())
    yield from unreachable(documents())
    yield from licences()


def main() -> int:
    """Print what is wrong; the exit status."""
    parser = argparse.ArgumentParser(description="Is this tree a release?")
    parser.add_argument("--tag", default="", help="the tag that is about to be set, v and the version")
    found = list(findings(parser.parse_args().tag))
    for line in found:
        print(line, file=sys.stderr)
    if not found:
        print(f"good: version {version()}")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
