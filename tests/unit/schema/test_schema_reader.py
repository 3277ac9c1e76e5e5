# SPDX-License-Identifier: Apache-2.0
"""Reading YAML: any text gives a configuration, or an error that says what is wrong with it."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

import cm.schema
from cm.schema import SchemaError
from cm.schema.reader import read
from cm.schema.tree import plain

GOOD = "config:\n  name: c\n  modes:\n    default: {}\n"


def refusal(text: str) -> tuple[str, int]:
    """Code and line of the first problem of `text`."""
    with pytest.raises(SchemaError) as caught:
        cm.schema.loads(text)
    return caught.value.problems[0].code, caught.value.problems[0].line


@pytest.mark.parametrize(
    ("text", "code", "line"),
    [
        ("", "yaml_syntax", 1),
        ("config: [}", "yaml_syntax", 1),
        ("a: b\n\tc: d", "yaml_syntax", 2),
        ("config:\n  name: \x01", "yaml_syntax", 2),
        ("config:\n  name: \ud800", "yaml_syntax", 2),
        (GOOD + "---\nconfig: {}", "yaml_syntax", 5),
        (GOOD + "  doc: !!python/object:os.system x", "yaml_syntax", 5),
        (GOOD + "  doc: *nowhere", "yaml_syntax", 5),
        ("config: &a\n  regions: *a", "yaml_syntax", 2),
        ("[" * 1000, "too_large", 1),
        ("x" * 2_000_000, "too_large", 1),
        ("a: &a [" + "1," * 2000 + "]\nb: &b [" + "*a," * 40 + "]\nc: [" + "*b," * 40 + "]", "too_large", 3),
        ("? [a]\n: b", "bad_type", 1),
        ("just text", "bad_type", 1),
        ("conf: {}", "unknown_key", 1),
    ],
)
def test_text_that_is_not_a_schema_is_refused(text: str, code: str, line: int) -> None:
    assert refusal(text) == (code, line)


@pytest.mark.parametrize(
    ("text", "where", "why"),
    [
        ('config:\n  name: "c\n  modes: {}\n', (4, 1), "while scanning a quoted scalar that begins in line 2"),
        ("config: {name: c\nmodes:\n", (2, 6), "while parsing a flow mapping that begins in line 1"),
        ("config:\n\tname: c\n", (2, 1), "YAML is indented with blanks, not with tabs"),
        ("config:\n  doc: gain: 1 to 4\n", (2, 12), "text with a colon and a blank in it stands in quotes"),
        ("config: [}", (1, 10), ""),
    ],
)
def test_what_is_not_yaml_says_what_people_usually_do(text: str, where: tuple[int, int], why: str) -> None:
    with pytest.raises(SchemaError) as caught:
        cm.schema.loads(text)
    (problem,) = caught.value.problems
    assert ((problem.line, problem.column), problem.hint) == (where, why)


@pytest.mark.parametrize("loader", [yaml.SafeLoader, getattr(yaml, "CSafeLoader", yaml.SafeLoader)])
def test_scalars_mean_the_same_with_and_without_libyaml(loader: Any) -> None:
    text = "[0x10, 0b11, 0o17, 1_000, -5, 1.5, 1e3, true, ~, null, no, 7:4, '5', \"0x10\", !!str 5, .inf, 1e999, 0x]"
    expected = [
        16,
        3,
        15,
        1000,
        -5,
        1.5,
        1000.0,
        True,
        None,
        None,
        "no",
        "7:4",
        "5",
        "0x10",
        "5",
        ".inf",
        "1e999",
        "0x",
    ]
    assert plain(read(text, lambda *_: None, loader)) == expected


@pytest.mark.parametrize("loader", [yaml.SafeLoader, getattr(yaml, "CSafeLoader", yaml.SafeLoader)])
def test_positions_are_the_same_with_and_without_libyaml(loader: Any) -> None:
    tree = read("a:\n  - b\n  - é: {c: d}\n", lambda *_: None, loader)
    assert tree.entries["a"].mark == (1, 1)  # type: ignore[union-attr]
    inner = tree.entries["a"].node.items[1].entries["é"].node  # type: ignore[union-attr]
    assert inner.mark == (3, 8)
    assert inner.entries["c"].mark == (3, 9)


def test_aliases_and_merge_keys_spare_repetition() -> None:
    config = cm.schema.loads(
        "x-camera: &camera {direction: s2mm, shape: [2, 3]}\n"
        "config:\n  name: c\n  modes: {default: {}}\n"
        "  streams:\n    left: *camera\n    right: {<<: *camera, shape: [4]}\n"
    )
    assert config.streams["left"].shape == (2, 3)
    assert (config.streams["right"].shape, config.streams["right"].direction.value) == ((4,), "s2mm")


def test_numbers_of_any_length_are_refused_not_computed() -> None:
    assert refusal(GOOD + "  clocks: {f: " + "9" * 100_000 + "}") == ("bad_type", 5)


def outcome(text: str) -> str:
    """Load `text`; anything but a configuration or a SchemaError with problems fails the test."""
    try:
        cm.schema.loads(text)
    except SchemaError as error:
        problems = error.problems
    else:
        return "good"
    assert problems
    assert all(problem.line >= 1 and problem.column >= 1 and problem.message for problem in problems)
    return problems[0].code


@settings(max_examples=100)
@given(st.text(max_size=200))
def test_any_text_is_loaded_or_refused(text: str) -> None:
    outcome(text)


@settings(max_examples=100)
@given(st.text("-:[]{}&*!|>'\"%#?,@` \n\tab01x<.~", max_size=60))
def test_any_text_of_yaml_signs_is_loaded_or_refused(text: str) -> None:
    outcome("config:\n  name: c\n  modes: {default: {}}\n  " + text)


def _words() -> list[str]:
    schema = cm.schema.json_schema()["definitions"]
    keys = {key for shape in schema.values() for key in shape.get("properties", ())}
    return sorted(keys | {"prr0", "a", "edge", "static", "<<"})


scalars = st.one_of(
    st.sampled_from(_words()), st.integers(-2, 2**65), st.floats(), st.booleans(), st.none(), st.text(max_size=3)
)
trees = st.recursive(
    scalars,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.sampled_from(_words()), inner, max_size=6),
    max_leaves=30,
)


@settings(max_examples=100)
@given(trees)
def test_any_structure_is_loaded_or_refused(tree: Any) -> None:
    outcome(yaml.safe_dump({"config": tree}))


@settings(max_examples=60)
@given(st.dictionaries(st.sampled_from(sorted(cm.schema.json_schema()["definitions"]["config"]["properties"])), trees))
def test_any_values_of_known_keys_are_loaded_or_refused(values: Any) -> None:
    outcome(yaml.safe_dump({"config": {"name": "c", "modes": {"default": {}}, **values}}))


def many(count: int, entry: str) -> str:
    return "{" + ", ".join(entry.format(index) for index in range(count)) + "}"


@pytest.mark.parametrize(
    "body",
    [
        many(20_000, "k{}: 1")[1:-1].replace(", ", "\n  "),  # unknown keys
        "modes: " + many(20_000, "m{}: {{}}") + "\n  streams: " + many(10_000, "s{}: {{direction: tx}}"),
        "modules: [" + "a, " * 20_000 + "]",
        "regions: " + many(60, "r{}: {{}}") + "\n  modules: " + many(2000, "a{}: {{region: r1}}"),
        "mmio: [" + "{base_address: 0, registers: {r: {offset: 0}}}, " * 2000 + "]",
        "mmio: [{base_address: 0, registers: {r: {offset: 0, fields: " + many(5000, "f{}: {{bits: 0}}") + "}}}]",
        "default_mode: " + "x" * 900_000,
        "? " + "x" * 900_000 + "\n  : 1",
    ],
    ids=["keys", "modes", "list", "modules", "windows", "fields", "name", "key"],
)
def test_a_hostile_file_is_refused_in_bounded_time_with_bounded_output(body: str) -> None:
    modes = "" if body.startswith("modes") else "  modes: {m: {}}\n"
    start = time.process_time()
    with pytest.raises(SchemaError) as caught:
        cm.schema.loads(f"config:\n  name: c\n{modes}  {body}\n")
    assert len(caught.value.problems) <= 100
    assert len(str(caught.value)) < 100_000
    assert time.process_time() - start < 10  # 0.1 to 1 s measured


def test_a_large_and_good_file_loads_in_bounded_time() -> None:
    registers = many(4000, "r{0}: {{offset: 0x{0}000}}")
    modes = many(200, "m{0}: {{mmio: [{{base_address: 0, registers: {{s: {{offset: 4}}}}}}]}}")
    start = time.process_time()
    mmio = f"[{{base_address: 0, registers: {registers}}}]"
    config = cm.schema.loads(f"config:\n  name: c\n  mmio: {mmio}\n  modes: {modes}")
    assert len(config.visible_registers("m1")) == 4001
    assert time.process_time() - start < 20  # 1.5 s measured


def test_a_file_that_is_not_utf_8_is_refused_at_its_line(tmp_path: Path) -> None:
    path = tmp_path / "latin.yaml"
    path.write_bytes(b"config:\n  name: c\n  doc: caf\xe9\n")
    (problem,) = cm.schema.check(path)
    assert (problem.code, problem.line, problem.message) == ("yaml_syntax", 3, "not UTF-8 text")


def test_half_a_surrogate_pair_is_named_in_the_error() -> None:
    with pytest.raises(SchemaError, match="a character that is not Unicode text"):
        cm.schema.loads("config:\n  name: \ud800")
