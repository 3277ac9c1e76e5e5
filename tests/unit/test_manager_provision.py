# SPDX-License-Identifier: Apache-2.0
"""Provisioned configurations: stored whole or not at all, and never reaching out of their folder."""

from __future__ import annotations

from pathlib import Path

import pytest

from cm.daemon.host.provision import SCHEMA_FILE, Provisioner
from cm.errors import InvalidRequest
from cm.manager.errors import ChangeBusy
from cm.messages.requests import File
from cm.schema import SchemaError

SCHEMA = """
config:
  name: sent
  type: partial
  modules:
    one: {bitstream: one.bit}
  modes:
    default: {modules: [one], overlays: [{name: nodes, file: nodes.dtbo}]}
"""
FILES = (File("one.bit", b"1"), File("nodes.dtbo", b"2"))


@pytest.fixture
def provisioner(tmp_path: Path) -> Provisioner:
    return Provisioner(tmp_path / "configs")


def content(provisioner: Provisioner) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for path in provisioner.stored() for p in path.parent.iterdir()}


def test_what_was_sent_is_stored_and_found_again(provisioner: Provisioner, tmp_path: Path) -> None:
    config = provisioner.store(SCHEMA, FILES)
    assert config.source == tmp_path / "configs" / "sent" / SCHEMA_FILE
    assert content(provisioner) == {SCHEMA_FILE: SCHEMA.encode(), "one.bit": b"1", "nodes.dtbo": b"2"}
    provisioner.store(SCHEMA, (File("one.bit", b"new"),))
    assert content(provisioner) == {SCHEMA_FILE: SCHEMA.encode(), "one.bit": b"new"}
    assert [p.name for p in (tmp_path / "configs").iterdir()] == ["sent"]


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("one.bit", "/etc/shadow"),
        ("one.bit", "../other/one.bit"),
        ("one.bit", "sub/../../one.bit"),
        ("nodes.dtbo", "/boot/base.dtbo"),
        ("nodes.dtbo", "../nodes.dtbo"),
        ("type: partial", "type: full\n  bitstream: /dev/mem"),
        ("type: partial", "overlays: [{name: base, file: ../base.dtbo}]"),
    ],
)
def test_a_path_that_leaves_the_folder_is_refused(provisioner: Provisioner, tmp_path: Path, old: str, new: str) -> None:
    with pytest.raises(InvalidRequest, match="leaves the configuration's folder"):
        provisioner.store(SCHEMA.replace(old, new), FILES)
    assert not (tmp_path / "configs").exists()


@pytest.mark.parametrize("name", ["../x", "/x", ".x", "", "a/b", "a\\b", SCHEMA_FILE])
def test_a_file_name_that_is_no_plain_name_is_refused(provisioner: Provisioner, name: str) -> None:
    with pytest.raises(InvalidRequest):
        provisioner.store(SCHEMA, (File(name, b"1"),))
    assert provisioner.stored() == []


def test_a_bad_schema_or_a_refusal_leaves_the_old_one(provisioner: Provisioner) -> None:
    provisioner.store(SCHEMA, FILES)
    before = content(provisioner)
    with pytest.raises(SchemaError):
        provisioner.store(SCHEMA.replace("modules: [one]", "modules: [two]"), FILES)

    def busy(name: str) -> None:
        raise ChangeBusy(name)

    with pytest.raises(ChangeBusy, match="sent"):
        provisioner.store(SCHEMA, (), busy)
    assert content(provisioner) == before


@pytest.mark.parametrize("after", range(3))
def test_a_kill_at_any_of_the_renames_leaves_the_old_one_or_the_new(
    provisioner: Provisioner, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, after: int
) -> None:
    class Killed(BaseException):
        pass

    provisioner.store(SCHEMA, FILES)
    count = 0
    rename = Path.rename

    def dying(self: Path, target: Path) -> Path:
        nonlocal count
        count += 1
        if count > after:
            raise Killed
        return rename(self, target)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "rename", dying)
        patch.setattr("cm.daemon.host.provision._remove", lambda *_, **__: None)  # nothing is tidied by the dead
        if after < 2:
            with pytest.raises(Killed):
                provisioner.store(SCHEMA, (File("one.bit", b"new"),))
        else:
            provisioner.store(SCHEMA, (File("one.bit", b"new"),))
    again = Provisioner(tmp_path / "configs")
    again.recover()
    assert content(again)["one.bit"] == (b"new" if after == 2 else b"1")
    assert [p.name for p in (tmp_path / "configs").iterdir()] == ["sent"]


def test_where_only_signed_configurations_are_taken_none_comes_over_the_wire(tmp_path: Path) -> None:
    text = "config: {name: mine, modules: {a: {}}, modes: {default: {modules: [a]}}}\n"
    assert Provisioner(tmp_path / "configs").store(text, ()).name == "mine"
    closed = Provisioner(tmp_path / "configs", unsigned=False)
    assert closed.configs() == {}
    with pytest.raises(InvalidRequest, match="requires signed configurations"):
        closed.store(text, ())
