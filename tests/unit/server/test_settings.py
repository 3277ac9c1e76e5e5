# SPDX-License-Identifier: Apache-2.0
"""Settings of the service: the meaning of a file, and the errors for a wrong one."""

from __future__ import annotations

import contextlib
import json
import re
import textwrap
from dataclasses import MISSING, fields, is_dataclass, replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cm.cli.main import main
from cm.server.settings import Settings, SettingsError, SettingsMissing, find_configs, load_settings, parse_settings
from cm.server.settings import settings_schema as schema
from cm.server.settings.model import USUAL, Limits, LimitSettings, ScrubSettings

ROOT = Path(__file__).resolve().parents[3]
SCHEMA = "config: {{name: {}, modules: {{a: {{}}}}, modes: {{m: {{modules: [a]}}}}}}\n"


def problems(text: str) -> list[tuple[int, int, str, str]]:
    with pytest.raises(SettingsError) as caught:
        parse_settings(text)
    return [(p.line, p.column, p.key, p.code) for p in caught.value.problems]


def test_the_shipped_file_says_nothing_but_the_defaults() -> None:
    assert load_settings(ROOT / "system/cm.yaml") == Settings()


def test_every_example_in_the_shipped_file_is_good() -> None:
    lines = (ROOT / "system/cm.yaml").read_text().splitlines()
    examples = [line[1:] for line in lines if line.startswith("#") and not line.startswith("# ")]
    assert len(examples) >= 8
    assert parse_settings("\n".join(examples)).load == "camera/default"


def test_how_often_a_region_is_compared_has_units_and_defaults() -> None:
    known = parse_settings("scrub: {prr0: {every: 5s, budget: 10 %}, prr1: {}}").scrub
    assert (known["prr0"].every, known["prr0"].budget) == (5.0, 0.1)
    assert known["prr1"] == ScrubSettings()


EXAMPLE = re.compile(r"^( {4}|)(?:listen|access|limits|policy):.*\n(?:^\1(?!```).*\n)*", re.MULTILINE)


@pytest.mark.parametrize("page", ["import", "security", "service"])
def test_every_example_of_settings_in_the_docs_is_good(page: str) -> None:
    examples = [found[0] for found in EXAMPLE.finditer((ROOT / f"docs/{page}.md").read_text())]
    assert examples
    for example in examples:
        assert parse_settings(textwrap.dedent(example)) != Settings()


def test_shares_are_numbers_by_name() -> None:
    assert parse_settings("limits: {shares: {anna: 4, laptop: 0.5}}").limits.shares == {"anna": 4, "laptop": 0.5}
    assert problems("limits: {shares: {anna: four}}") == [(1, 19, "limits.shares.anna", "bad_type")]


def test_schema_and_data_name_the_same_keys_with_the_same_defaults() -> None:
    def compare(shape: dict[str, object], data: object) -> None:
        properties = shape["properties"]
        assert isinstance(properties, dict)
        assert is_dataclass(data)
        assert set(properties) == {field.name for field in fields(data)}
        for name, described in properties.items():
            value = getattr(data, name)
            if "properties" in described:
                compare(described, value)
            elif "default" in described:
                assert described["default"] == (list(value) if isinstance(value, tuple) else value)

    compare(schema(), Settings())


@pytest.mark.parametrize("name", [one.name for one in fields(Limits)])
def test_each_limit_has_its_default_and_its_value_from_the_settings_alone(name: str) -> None:
    assert all(one.default is one.default_factory is MISSING for one in fields(Limits))
    key = name.replace("_bytes", "_mib")
    said = replace(LimitSettings(), **{key: getattr(LimitSettings(), key) + 1})
    unit = 1 << 20 if key.endswith("_mib") else 1
    assert Limits.of(said) == replace(USUAL, **{name: getattr(USUAL, name) + unit})


def test_one_address_may_stand_without_a_list() -> None:
    assert parse_settings("listen: tcp://0.0.0.0:5560\n").listen == ("tcp://0.0.0.0:5560",)


def test_a_port_for_metrics_is_a_number_or_text() -> None:
    assert [parse_settings(f"metrics: {said}").metrics for said in ("9469", "'9469'", "kria:9469")] == [
        "9469", "9469", "kria:9469",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("listn: []\n", (1, 1, "listn", "unknown_key")),
        ("log: loud\n", (1, 1, "log", "bad_value")),
        ("\nkeys: server.key\n", (2, 1, "keys", "bad_value")),
        ("listen: ['udp://x']\n", (1, 10, "listen[0]", "bad_value")),
        ("streams: {queue_mib: -1}\n", (1, 11, "streams.queue_mib", "value_range")),
        ("listen: [tcp://a:5560, 'tcp://a:70000']\n", (1, 24, "listen[1]", "value_range")),
        ("metrics: 'kria:99999'\n", (1, 1, "metrics", "value_range")),
        ("metrics: 99999\n", (1, 1, "metrics", "value_range")),
        ("scrub: {prr0: {budget: 200 %}}\n", (1, 16, "scrub.prr0.budget", "value_range")),
        ("scrub: {prr0: {budget: 0 %}}\n", (1, 16, "scrub.prr0.budget", "value_range")),
        ("imports: {keep: '3'}\n", (1, 11, "imports.keep", "bad_type")),
        ("- listen\n", (1, 1, "", "bad_type")),
        ("log: [\n", (2, 1, "", "yaml_syntax")),
        ("access:\n  users: {anna: obsrve}\n", (2, 17, "access.users.anna[0]", "unknown_role")),
    ],
)
def test_a_mistake_in_the_settings_is_reported_with_its_place(text: str, found: tuple[int, int, str, str]) -> None:
    assert found in problems(text)


def test_all_mistakes_in_the_settings_are_reported_at_once() -> None:
    assert len(problems("log: loud\nlisten: [x]\nkeys: y\n")) == 3


@given(st.text(max_size=200))
def test_any_text_is_settings_or_an_error(text: str) -> None:
    with contextlib.suppress(SettingsError):
        assert isinstance(parse_settings(text), Settings)


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(SettingsMissing, match=r"none\.yaml"):
        load_settings(tmp_path / "none.yaml")


def test_the_first_of_a_name_on_the_search_path_counts(tmp_path: Path) -> None:
    for folder in ("first", "second"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "a.yaml").write_text(SCHEMA.format("vision"))
    found = find_configs([f"{tmp_path}/first", f"{tmp_path}/second", f"{tmp_path}/not-there"])
    assert found.configs["vision"].source == tmp_path / "first/a.yaml"
    assert len(found.left_out) == 1
    assert "second" in found.left_out[0]


def test_a_star_matches_every_folder_except_those_of_unfinished_imports(tmp_path: Path) -> None:
    for folder in ("radio", "vision", ".import-x", ".vision.old"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "a.yaml").write_text(SCHEMA.format(folder.strip(".")))
    assert list(find_configs([f"{tmp_path}/*"]).configs) == ["radio", "vision"]


def test_a_schema_that_is_wrong_is_left_out_and_the_others_are_there(tmp_path: Path) -> None:
    (tmp_path / "bad.yaml").write_text("config: {name: 3\n")
    (tmp_path / "good.yaml").write_text(SCHEMA.format("vision"))
    found = find_configs([str(tmp_path)])
    assert list(found.configs) == ["vision"]
    assert "bad.yaml:" in found.left_out[0]


def test_check_settings_prints_what_is_wrong_like_a_compiler(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "cm.yaml"
    file.write_text("lissten: []\n")
    assert main(["check", "--settings", str(file)]) == 1
    assert capsys.readouterr().out.startswith(f"{file}:1:1: lissten: unknown key 'lissten' (did you mean listen?)")


def test_check_settings_tells_what_the_service_would_refuse(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "cm.yaml"
    file.write_text("listen: [tcp://0.0.0.0]\n")
    assert main(["check", "--settings", str(file)]) == 1
    assert capsys.readouterr().out.startswith(f"{file}: listens on TCP without keys, which the service refuses: 'keys:")


def test_check_settings_prints_the_schema_for_editors(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", "--settings", "--print-schema"]) == 0
    assert json.loads(capsys.readouterr().out) == schema()


def test_the_documentation_has_every_key_and_no_other() -> None:
    text = (ROOT / "docs/service.md").read_text()
    table = text.split("<!-- every key")[1].split("\n## ")[0].split("\nAlong")[0]
    named = {line.split("`")[1] for line in table.splitlines() if line.startswith("| `")}
    keys = set()
    for name, described in schema()["properties"].items():
        keys |= {f"{name}.{inner}" for inner in described["properties"]} if "properties" in described else {name}
    assert named == keys
