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
from cm.server.rights.model import Access, Grant, Role
from cm.server.settings.config_search import find_configs
from cm.server.settings.loader import SettingsError, SettingsMissing, load_settings, parse_settings
from cm.server.settings.loader import settings_schema as schema
from cm.server.settings.model import (
    USUAL,
    DmaSettings,
    ImportSettings,
    Limits,
    LimitSettings,
    PolicySettings,
    RecordSettings,
    ScrubSettings,
    Settings,
    StreamSettings,
)

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


@pytest.mark.parametrize(
    ("said", "every", "budget"),
    [
        ("{every: 5s, budget: 10 %}", 5.0, 0.1), ("{every: 2.5 min, budget: 100%}", 150.0, 1.0),
        ("{every: 1h, budget: 0.5 %}", 3600.0, 0.005), ("{every: 250 ms}", 0.25, 0.02),
        ("{every: 1ms, budget: 0.001 %}", 0.1, 0.0001), ("{}", 10.0, 0.02), ("", 10.0, 0.02),
    ],
)  # fmt: skip
def test_how_often_a_region_is_compared_has_units_and_defaults(said: str, every: float, budget: float) -> None:
    assert parse_settings(f"scrub: {{prr0: {said}}}").scrub == {"prr0": ScrubSettings(pytest.approx(every), budget)}


def test_everything_that_is_said_is_known() -> None:
    known = parse_settings("""
listen: [tcp://0.0.0.0:5560, tcp://localhost]
keys: /etc/cm/server.key
insecure: true
configs: [/srv/a, /srv/b/*]
load: camera/edge
name: bench
runtime_dir: /run/a
state_dir: /srv/state
assume_loaded: true
log: info
streams: {queue_mib: 1.5}
dma: {prefetch_mib: 7}
scrub: {prr0: {policy: tell}}
record: {folder: /srv/box, ring: 5min, streams: [camera], frames: hash}
imports: {keep: 4}
policy: {signatures: warn, signers: /srv/signers, older: refuse}
limits: {leases: 5}
access:
  group: lab
  local: observe
  insecure: [operate, tuner]
  keys: /srv/keys
  users: {anna: tuner, '1001': [admin, observe]}
  groups: {wheel: [admin]}
  guests: {'web:*': []}
  roles: {tuner: {role: operate, registers: [focus, 'led.*'], regions: [prr0], guests: ['web:*']}}
""")
    assert known == Settings(
        ("tcp://0.0.0.0:5560", "tcp://localhost"), Path("/etc/cm/server.key"), True, ("/srv/a", "/srv/b/*"),
        "camera/edge", "bench", Path("/run/a"), Path("/srv/state"), True, "info",
        StreamSettings(1.5), DmaSettings(7), {"prr0": ScrubSettings(policy="tell")},
        RecordSettings("/srv/box", "5min", ("camera",), "hash"), ImportSettings(4),
        PolicySettings("warn", Path("/srv/signers"), "refuse"), LimitSettings(leases=5),
        Access(
            "lab", ("observe",), ("operate", "tuner"), {"anna": ("tuner",), "1001": ("admin", "observe")},
            {"wheel": ("admin",)}, {"web:*": ()},
            {"tuner": Grant(Role.OPERATE, regions=("prr0",), registers=("focus", "led.*"), guests=("web:*",))},
            keys_folder=Path("/srv/keys"),
        ),
    )  # fmt: skip


EXAMPLE = re.compile(r"^( {4}|)(?:listen|access|limits|policy):.*\n(?:^\1(?!```).*\n)*", re.MULTILINE)


@pytest.mark.parametrize("page", ["import", "security", "service"])
def test_every_example_of_settings_in_the_docs_is_good(page: str) -> None:
    examples = [found[0] for found in EXAMPLE.finditer((ROOT / f"docs/{page}.md").read_text())]
    assert examples
    for example in examples:
        assert parse_settings(textwrap.dedent(example)) != Settings()


def test_schema_and_data_name_the_same_keys_with_the_same_defaults() -> None:
    def compare(shape: dict[str, object], data: object) -> None:
        properties = shape["properties"]
        assert isinstance(properties, dict)
        assert is_dataclass(data)
        assert set(properties) == {field.name for field in fields(data)} - {"keys_folder"}  # `keys` in the file
        for name, described in properties.items():
            value = getattr(data, name)
            if "properties" in described:
                compare(described, value)
            elif "default" in described:
                assert described["default"] == (list(value) if isinstance(value, tuple) else value)

    compare(schema(), Settings())


SHARES = {  # of one user: of which limit, and how much of it
    "leases": ("leases_each", 1 / 8), "memory_mib": ("memory_each_bytes", 3 / 4),
    "provisioned_mib": ("provisioned_each_bytes", 1 / 2), "uploads_mib": ("upload_bytes", 1 / 2),
}  # fmt: skip


@pytest.mark.parametrize("key", [one.name for one in fields(LimitSettings)])
def test_each_limit_has_its_default_and_its_value_from_the_settings_alone_and_a_user_has_a_share(key: str) -> None:
    assert all(one.default is one.default_factory is MISSING for one in fields(Limits))
    said = replace(LimitSettings(), **{key: getattr(LimitSettings(), key) + 8})
    name, more = key.replace("_mib", "_bytes"), 8 << 20 if key.endswith("_mib") else 8
    wanted = {name: getattr(USUAL, name) + more}
    if share := SHARES.get(key):
        wanted[share[0]] = int(wanted[name] * share[1])
    assert Limits.of(said) == replace(USUAL, **wanted)


def test_one_address_may_stand_without_a_list() -> None:
    assert parse_settings("listen: tcp://0.0.0.0:5560\n").listen == ("tcp://0.0.0.0:5560",)


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("listn: []\n", (1, 1, "listn", "unknown_key")),
        ("log: loud\n", (1, 1, "log", "bad_value")),
        ("\nkeys: server.key\n", (2, 1, "keys", "bad_value")),
        ("listen: ['udp://x']\n", (1, 10, "listen[0]", "bad_value")),
        ("streams: {queue_mib: -1}\n", (1, 11, "streams.queue_mib", "value_range")),
        ("listen: [tcp://a:5560, 'tcp://a:70000']\n", (1, 24, "listen[1]", "value_range")),
        ("scrub: {prr0: {budget: 200 %}}\n", (1, 16, "scrub.prr0.budget", "value_range")),
        ("scrub: {prr0: {budget: 0 %}}\n", (1, 16, "scrub.prr0.budget", "value_range")),
        ("imports: {keep: '3'}\n", (1, 11, "imports.keep", "bad_type")),
        ("- listen\n", (1, 1, "", "bad_type")),
        ("log: [\n", (2, 1, "", "yaml_syntax")),
        ("access:\n  users: {anna: obsrve}\n", (2, 17, "access.users.anna[0]", "unknown_role")),
        ("access: {local: [observe, tuner]}\n", (1, 27, "access.local[1]", "unknown_role")),
        ("access: {insecure: none}\n", (1, 20, "access.insecure[0]", "unknown_role")),
        ("access: {groups: {lab: [Observe]}}\n", (1, 25, "access.groups.lab[0]", "unknown_role")),
        ("access: {guests: {a: [b]}}\n", (1, 23, "access.guests.a[0]", "unknown_role")),
        ("scrub: {a: {budget: 100.1 %}}\n", (1, 13, "scrub.a.budget", "value_range")),
    ],
)
def test_a_mistake_in_the_settings_is_reported_with_its_place(text: str, found: tuple[int, int, str, str]) -> None:
    assert found in problems(text)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("access: {local: [obsrve]}", "no role 'obsrve' (did you mean observe?)"),
        ("access: {local: [tunr], roles: {tuner: {role: map}}}", "no role 'tunr' (did you mean tuner?)"),
        ("scrub: {a: {budget: 101%}}", "'101%' is no share of the time (more than 0 %, at most 100 %)"),
    ],
)
def test_a_mistake_in_the_settings_is_told_with_what_would_be_right(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "cm.yaml").write_text(text, "utf-8-sig")
    with pytest.raises(SettingsError) as caught:
        load_settings(tmp_path / "cm.yaml")
    (problem,) = caught.value.problems
    assert str(problem).startswith(f"{tmp_path}/cm.yaml:1:")
    assert str(problem).endswith(f": {said}")
    assert caught.value.code == "settings_invalid"


def test_the_limits_of_values_are_accepted_and_blanks_and_comments_say_nothing() -> None:
    assert parse_settings("scrub: {a: {budget: 100 %}}\n").scrub["a"].budget == 1.0
    assert parse_settings("\n  # a comment\n\t\n#log: loud\n") == Settings()


def test_all_mistakes_in_the_settings_are_reported_at_once() -> None:
    assert len(problems("log: loud\nlisten: [x]\nkeys: y\n")) == 3


@given(st.text(max_size=200))
def test_any_text_is_settings_or_an_error(text: str) -> None:
    with contextlib.suppress(SettingsError):
        assert isinstance(parse_settings(text), Settings)


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(SettingsMissing, match=r"none\.yaml: No such file or directory"):
        load_settings(tmp_path / "none.yaml")
    with pytest.raises(SettingsMissing, match=f"{tmp_path}: Is a directory"):
        load_settings(tmp_path)
    (tmp_path / "cm.yaml").write_bytes(b"name: \xff")
    with pytest.raises(SettingsError, match=r"cm\.yaml:1:1: not UTF-8 text \(save the file as UTF-8\)"):
        load_settings(tmp_path / "cm.yaml")


def test_the_first_of_a_name_on_the_search_path_counts(tmp_path: Path) -> None:
    for folder in ("first", "second"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "a.yaml").write_text(SCHEMA.format("vision"))
    found = find_configs([f"{tmp_path}/first", f"{tmp_path}/second", f"{tmp_path}/not-there"])
    assert found.configs["vision"].source == tmp_path / "first/a.yaml"
    first, second = (tmp_path / folder / "a.yaml" for folder in ("first", "second"))
    assert found.left_out == (f"{second}: configuration vision comes from {first}, which is found first",)
    assert find_configs([str(second), str(first)]).configs["vision"].source == second  # files may be named too


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


def test_the_documentation_names_every_key() -> None:
    settings = (ROOT / "docs/service.md").read_text().split("**cm.yaml(5)**")[1].split("\n## ")[0]
    named = {key.rpartition(".")[2] for key in re.findall(r"`([a-z_.]+)`", settings)}
    inner = {
        key for name, part in schema()["properties"].items() if name != "limits" for key in part.get("properties", ())
    }
    assert set(schema()["properties"]) | inner <= named | {"policy", "access", "record", "imports", "streams", "dma"}
