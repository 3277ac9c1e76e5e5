# SPDX-License-Identifier: Apache-2.0
"""Every block of every page runs as it stands there, in order, in an empty folder, or says why it does not."""

from __future__ import annotations

from pathlib import Path

import pytest
from manager_process import REPOSITORY
from pages import PageFailed, blocks, indented, read, suite

PAGES = sorted(
    path
    for pattern in ("README.md", "docs/**/*.md", "clients/*/README.md", "yocto/meta-cm/README.md")
    for path in REPOSITORY.glob(pattern)
    if "reference" not in path.parts
)
# The suites that pages may name; by these words the files of a suite are found.
MARKS: dict[str, tuple[pytest.MarkDecorator, ...]] = {
    "plain": (),
    "design": (pytest.mark.design,),
    "networks": (pytest.mark.networks,),
    "programs": (pytest.mark.programs,),
    "web": (pytest.mark.web,),
}


def text_of(path: Path) -> str:
    return path.read_text("utf-8")


def parameters() -> list[object]:
    """Those pages that have blocks to run; with the marker of their suite."""
    found = []
    for path in PAGES:
        name, page = str(path.relative_to(REPOSITORY)), text_of(path)
        runs = suite(page) != "rtl"  # those are in tests/rtl
        if runs and any(
            not block.reason and block.kind not in ("text", "mermaid", "{toctree}") for block in blocks(page)
        ):
            # A newcomer's run takes README; the other pages are half a minute that it does without.
            further = "programs" if suite(page) == "plain" and name != "README.md" else suite(page)
            found.append(pytest.param(path, id=name.replace("/", "-"), marks=MARKS[further]))
    return found


@pytest.mark.parametrize("path", parameters())
def test_the_blocks_of_a_page_run_as_they_stand_there(path: Path) -> None:
    read(text_of(path), str(path.relative_to(REPOSITORY)))


def test_every_block_says_its_language() -> None:
    bare = [f"{path.relative_to(REPOSITORY)}:{line}" for path in PAGES for line in indented(text_of(path))]
    bare += [
        f"{path.relative_to(REPOSITORY)}:{block.line}"
        for path in PAGES
        for block in blocks(text_of(path))
        if not block.kind
    ]
    assert not bare


@pytest.mark.parametrize(
    ("page", "said"),
    [
        ("```sh\ncd nowhere\n```\n", "page.md:1: a command failed"),
        ("a\n\n```python\nx = 1\n```\n\n```python\nprint(y)\n```\n", "page.md:7: Python says"),
        ("```console\n$ echo one 2\none 3\nmore\n```\n", "`echo one 2` did not print: more"),
        ("```verilog\nmodule m; endmodule\n```\n", "say why it does not run"),
    ],
)
def test_a_block_that_does_not_do_what_it_says_is_told_with_its_line(page: str, said: str) -> None:
    with pytest.raises(PageFailed) as failed:
        read(page, "page.md")
    assert said in str(failed.value)


def test_shell_and_python_see_the_same_folder_and_variables() -> None:
    page = (
        "```python\n# mine.py\nword = 'blue'\n```\n\n```sh\nexport COLOUR=green\ntest -f mine.py\n```\n\n"
        "```python\nimport mine, os\nopen('said', 'w').write(mine.word + os.environ['COLOUR'])\n```\n\n"
        "<!-- not run: there is no such command -->\n```sh\nparadise\n```\n\n"
        "```console\n$ cat said; echo\nbluegreen\n```\n"
    )
    read(page, "page.md")
