# SPDX-License-Identifier: Apache-2.0
"""The build schema: what is read from it, and that every mistake is reported at its place."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from build_support import EXAMPLES, MINIMAL, NAMES, project

from cm.design.project.load import SCHEMA_FILE, load_project
from cm.schema import SchemaError
from cm.schema.model import Access, LoaderKind


@pytest.mark.parametrize("name", NAMES)
def test_the_shipped_examples_are_good(name: str) -> None:
    load_project(EXAMPLES / name / "build.yaml")


def test_a_small_schema_gets_its_defaults(tmp_path: Path) -> None:
    found = load_project(project(tmp_path))
    region, module = found.regions["prr0"], found.modules["one"]
    assert (region.clock, region.loader, region.pblock, region.window) == ("fclk0", LoaderKind.AUTO, (), 0x10000)
    assert (module.top, module.regions, module.sources) == ("one", ("prr0",), (tmp_path / "one.v",))
    assert found.modes["one"].modules == {"prr0": "one"}
    assert found.default_mode == "one"


def test_a_mode_may_list_modules_that_fit_one_region_each(tmp_path: Path) -> None:
    found = load_project(project(tmp_path, MINIMAL + "modes: {first: {modules: [one]}}\n"))
    assert found.modes["first"].modules == {"prr0": "one"}


def test_a_pattern_matches_files_in_sorted_order(tmp_path: Path) -> None:
    path = project(tmp_path, MINIMAL.replace("[one.v]", "['*.v']"), b="", a="")
    assert [file.name for file in load_project(path).modules["one"].sources] == ["a.v", "b.v", "one.v"]


def test_registers_are_read_with_fields(tmp_path: Path) -> None:
    text = MINIMAL + "    registers: {gain: {offset: 0x10, access: w1c, max: 7, fields: {low: {lsb: 1, width: 2}}}}\n"
    register = load_project(project(tmp_path, text)).modules["one"].registers["gain"]
    assert (register.offset, register.access, register.maximum) == (0x10, Access.W1C, 7)
    assert (register.fields["low"].lsb, register.fields["low"].width) == (1, 2)


MISTAKES = {
    "unknown key": (MINIMAL.replace("pblock", "pblok"), 3, "unknown_key", "did you mean pblock?"),
    "missing key": (MINIMAL.replace(", part: xc7z020clg400-1", ""), 1, "missing_key", "part is missing"),
    "wrong type": (MINIMAL.replace("pblock: auto", "window: big"), 3, "bad_type", "expected an integer"),
    "missing file": (MINIMAL.replace("one.v", "two.v"), 6, "file_not_found", "two.v does not exist"),
    "foreign part": (MINIMAL.replace("xc7z020clg400-1", "xc7a35tcpg236-1"), 1, "bad_value", "Zynq"),
    "window": (MINIMAL.replace("pblock: auto", "window: 5000"), 3, "bad_value", "not a power of two"),
    "clock": (MINIMAL.replace("pblock: auto", "clock: fclk7"), 3, "unknown_clock", "did you mean fclk0?"),
    "region": (MINIMAL + "    regions: [prr0, prr1]\n", 7, "unknown_region", "did you mean prr0?"),
    "module in a mode": (MINIMAL + "modes: {m: {modules: {prr0: on}}}\n", 7, "unknown_module", "did you mean one?"),
    "default mode": (MINIMAL + "default_mode: two\n", 7, "unknown_mode", "known: one"),
    "two modules in one region": (
        MINIMAL + "  two: {sources: [one.v]}\nmodes: {m: {modules: [one, two]}}\n",
        8,
        "region_conflict",
        "both go to prr0",
    ),
    "unaligned register": (
        MINIMAL + "    registers: {a: {offset: 2}}\n",
        7,
        "bad_alignment",
        "not a multiple of 4 bytes",
    ),
    "default out of range": (
        MINIMAL + "    registers: {a: {offset: 4, default: 9, max: 7}}\n",
        7,
        "value_range",
        "is out of range",
    ),
    "field too high": (
        MINIMAL + "    registers: {a: {offset: 4, width: 8, fields: {f: {lsb: 7, width: 2}}}}\n",
        7,
        "value_range",
        "of a register of 8 bits",
    ),
    "register in a mode": (
        MINIMAL + "modes: {m: {modules: [one], registers: {gian: 1}}}\n",
        7,
        "unknown_register",
        "no register 'gian'",
    ),
    "not YAML": ("project: [", 2, "yaml_syntax", "not YAML"),
    "duplicate": (MINIMAL + "    sources: [one.v]\n", 7, "duplicate_key", "in line 6 already"),
    "nothing to build": (MINIMAL.replace("sources: [one.v]", "doc: x"), 5, "missing_key", "nothing to build it from"),
    "ip without a description": (
        MINIMAL.replace("sources: [one.v]", "ip: [one.v]"),
        6,
        "missing_key",
        "vendor IP cannot be parsed",
    ),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_reported_at_its_line(name: str, tmp_path: Path) -> None:
    text, line, code, words = MISTAKES[name]
    with pytest.raises(SchemaError) as caught:
        load_project(project(tmp_path, text))
    problems = caught.value.problems
    assert [(p.line, p.code) for p in problems] == [(line, code)], [str(p) for p in problems]
    assert words in str(problems[0])
    assert problems[0].path == tmp_path / "build.yaml"


def test_all_mistakes_are_reported_in_the_order_of_the_file(tmp_path: Path) -> None:
    text = MINIMAL.replace("pblock: auto", "clock: fclk9, window: 5000") + "default_mode: zero\n"
    with pytest.raises(SchemaError) as caught:
        load_project(project(tmp_path, text))
    assert [problem.line for problem in caught.value.problems] == [3, 3, 7]


def test_a_module_must_say_where_it_goes_when_there_are_several_regions(tmp_path: Path) -> None:
    text = MINIMAL.replace("  prr0: {pblock: auto}", "  prr0: {}\n  prr1: {}")
    with pytest.raises(SchemaError, match="with several regions, a module must say which of them it fits"):
        load_project(project(tmp_path, text))


@pytest.mark.parametrize("name", NAMES)
def test_editors_that_take_the_json_schema_find_no_fault_with_the_examples(name: str) -> None:
    import fastjsonschema
    import yaml

    validate = fastjsonschema.compile(json.loads(SCHEMA_FILE.read_text()))
    validate(yaml.safe_load((EXAMPLES / name / "build.yaml").read_text()))


def test_a_single_file_needs_no_list(tmp_path: Path) -> None:
    found = load_project(project(tmp_path, MINIMAL.replace("[one.v]", "one.v")))
    assert [path.name for path in found.modules["one"].sources] == ["one.v"]


def test_every_key_has_a_description() -> None:
    """Hints of errors quote it."""
    missing: list[str] = []

    def walk(node: object, path: str) -> None:
        if isinstance(node, dict):
            for key, value in node.get("properties", {}).items():
                if "description" not in value and "$ref" not in value:
                    missing.append(f"{path}.{key}")
            for key, value in node.items():
                walk(value, f"{path}.{key}")

    walk(json.loads(SCHEMA_FILE.read_text()), "")
    assert not missing
