# SPDX-License-Identifier: Apache-2.0
"""`make release-check`: what it finds in trees that are not a release, and the bill of materials."""

from __future__ import annotations

import json
from pathlib import Path
from types import ModuleType

import pytest
from scripts import script

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def check(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The checker, looking at a tree of the test's own."""
    module = script("release/check.py")
    monkeypatch.setattr(module, "ROOT", tmp_path)
    for name, text in (
        ("cm/_version.py", '__version__ = "1.2.3"\n'),
        ("kmod/dkms.conf", 'PACKAGE_VERSION="1.2.3"\n'),
        ("debian/changelog", "fpga-cm (1.2.3-1) unstable; urgency=medium\n"),
        ("CHANGELOG.md", "# Changelog\n\n## Unreleased\n\n- Something.\n"),
    ):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    return module


def test_places_with_another_version_are_named(check: ModuleType, tmp_path: Path) -> None:
    assert list(check.wrong_versions("1.2.3")) == []
    (tmp_path / "kmod/main.c").write_text('MODULE_VERSION("1.2.2");\n')
    assert list(check.wrong_versions("1.2.3")) == ["kmod/main.c: version 1.2.2, where cm/_version.py says 1.2.3"]


def test_a_release_has_a_section_with_its_date(check: ModuleType, tmp_path: Path) -> None:
    assert list(check.changelog("1.2.3", released=False)) == []
    assert len(list(check.changelog("1.2.3", released=True))) == 1
    (tmp_path / "CHANGELOG.md").write_text("## Unreleased\n\n## 1.2.3 - 2026-11-22\n\n- Something.\n")
    assert list(check.changelog("1.2.3", released=True)) == []
    assert list(check.changelog("1.2.3", released=False)) == ["CHANGELOG.md: the section says nothing"]
    (tmp_path / "CHANGELOG.md").write_text("## 1.2.3 - 2026-11-22\n\n- Something.\n")
    assert list(check.changelog("1.2.3", released=False)) == []


def test_links_to_what_is_not_there_are_found(check: ModuleType, tmp_path: Path) -> None:
    (tmp_path / "other.md").write_text("# The way, back\n")
    page = tmp_path / "page.md"
    page.write_text(
        "[a](other.md) [b](other.md#the-way-back) [c](https://example.org/x) `[d](gone.md)`\n"
        "[e](gone.md) [f](other.md#the-way)\n"
    )
    found = list(check.broken_links([page]))
    assert [line.split("link to ")[1] for line in found] == [
        "gone.md: no such file",
        "other.md#the-way: no such heading",
    ]


def test_the_documentation_of_this_tree_has_no_broken_link() -> None:
    module = script("release/check.py")
    assert list(module.broken_links(module.documents())) == []


def test_pages_that_no_link_leads_to_are_found(check: ModuleType, tmp_path: Path) -> None:
    (tmp_path / "docs").mkdir()
    texts = {"README.md": "[a](docs/a.md)", "docs/a.md": "[b](b.md#x) [a](a.md)", "docs/b.md": "", "docs/lost.md": ""}
    for name, text in texts.items():
        (tmp_path / name).write_text(text)
    found = list(check.unreachable([tmp_path / name for name in texts]))
    assert found == ["docs/lost.md: no link leads here from README.md"]


def test_every_page_of_this_tree_is_linked_from_the_readme() -> None:
    module = script("release/check.py")
    assert list(module.unreachable(module.documents())) == []


def test_versions_in_this_tree_are_one() -> None:
    module = script("release/check.py")
    assert list(module.wrong_versions(module.version())) == []


def test_the_bill_of_materials_is_valid_cyclonedx_and_names_what_is_declared(tmp_path: Path) -> None:
    validation = pytest.importorskip("cyclonedx.validation.json")
    from cyclonedx.schema import SchemaVersion

    (tmp_path / "fpga_cm-1.whl").write_bytes(b"")
    bill = script("release/sbom.py").bill("1.2.3", [tmp_path / "fpga_cm-1.whl"])
    assert validation.JsonStrictValidator(SchemaVersion.V1_6).validate_str(json.dumps(bill)) is None
    names = {part["name"] for part in bill["components"]}
    assert names == {"cffi", "fastjsonschema", "numpy", "protobuf", "pyyaml", "pyzmq"}
