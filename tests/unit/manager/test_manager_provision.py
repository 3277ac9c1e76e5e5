# SPDX-License-Identifier: Apache-2.0
"""Provisioned configurations: stored completely or not at all, and never outside of their folder."""

from __future__ import annotations

import errno
import gc
import hashlib
import itertools
import os
import re
from collections.abc import Callable
from dataclasses import replace
from mmap import mmap
from pathlib import Path

import pytest

from cm.device.native.folder_exchange import exchange
from cm.errors import Forbidden, InvalidRequest
from cm.manager.errors import ChangeBusy, UnknownConfig
from cm.schema import SchemaError, loads
from cm.server.provision import SCHEMA_FILE, NoSpace, NotStored, Owned, Provisioner, QuotaExceeded, Reserved, Sender
from cm.server.settings.model import USUAL
from cm.wire.messages.requests import File

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
    found = (p for path in provisioner.stored() for p in path.parent.iterdir())
    return {p.name: p.read_bytes() for p in found if p.name != ".owner"}


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
    with pytest.raises(
        InvalidRequest,
        match=r"leaves the configuration's folder; .* sent names files that are sent with it, such as edge\.bit",
    ):
        provisioner.store(SCHEMA.replace(old, new), FILES)
    assert not (tmp_path / "configs").exists()


@pytest.mark.parametrize("name", ["../x", "/x", ".x", "", "a/b", "a\\b", "a\0b", "a" * 201, SCHEMA_FILE])
def test_a_file_name_that_is_not_plain_is_refused(provisioner: Provisioner, name: str) -> None:
    with pytest.raises(
        InvalidRequest, match=r"a plain name without folders is expected, such as 'edge\.bit'|none may be"
    ):
        provisioner.store(SCHEMA, (File(name, b"1"),))
    assert provisioner.stored() == []


@pytest.mark.parametrize(("name", "hint"), [("ome.bit", "did you mean one.bit?"), ("README", "known: one.bit, ")])
def test_a_file_that_the_schema_does_not_name_is_refused(provisioner: Provisioner, name: str, hint: str) -> None:
    with pytest.raises(InvalidRequest, match=f"names no file '{name}' .{re.escape(hint)}"):
        provisioner.store(SCHEMA, (*FILES, File(name, b"3")))
    assert provisioner.stored() == []


def test_files_that_are_too_much_together_are_refused(provisioner: Provisioner) -> None:
    half = memoryview(mmap(-1, (256 << 20) + 1))  # never touched: it takes no memory
    with pytest.raises(InvalidRequest, match="files of 'sent' have more than 512 MiB together"):
        provisioner.store(SCHEMA, (File("one.bit", half), File("nodes.dtbo", half)))
    assert provisioner.stored() == []


@pytest.mark.parametrize(
    ("files", "said"),
    [
        ((*FILES, FILES[0]), r"files of 'sent': names must differ, and none may be 'schema\.yaml'"),
        (
            (File("one.bit", b"1", sha256="0" * 64),),
            "cm_write_config: file 'one.bit' does not have the sha256 announced for it",
        ),
    ],
)
def test_files_that_are_not_what_was_announced_are_refused(
    provisioner: Provisioner, files: tuple[File, ...], said: str
) -> None:
    with pytest.raises(InvalidRequest, match=said):
        provisioner.store(SCHEMA, files)
    assert provisioner.stored() == []
    sha256 = hashlib.sha256(b"1").hexdigest()
    for announced in (sha256, sha256.upper()):
        stored = provisioner.store(SCHEMA, (File("one.bit", b"1", sha256=announced),))
        assert stored.sha256_source == hashlib.sha256(SCHEMA.encode()).hexdigest()


def test_a_file_may_have_each_name_by_which_it_is_looked_for(provisioner: Provisioner) -> None:
    schema = """
config:
  name: sent
  type: full
  modules: {one: {}, two: {bitstream: second.bin}}
  overlays: [base]
  modes: {default: {modules: [one]}}
"""
    names = {"sent.bit", "one.bit", "one.bin", "one.bit.bin", "one.dtbo", "second.bin", "two.dtbo", "base.dtbo"}
    provisioner.store(schema, tuple(File(name, b"1") for name in sorted(names)))
    assert content(provisioner).keys() == {SCHEMA_FILE, *names}


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


class Killed(BaseException):
    """A process that is gone: it cleans up nothing."""


@pytest.mark.parametrize("after", [False, True])
def test_a_kill_at_the_exchange_leaves_the_old_one_or_the_new(
    provisioner: Provisioner, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, after: bool
) -> None:
    provisioner.store(SCHEMA, FILES)

    def dying(one: str, other: str) -> None:
        if after:
            exchange(one, other)
        raise Killed

    with monkeypatch.context() as patch:
        patch.setattr("cm.server.provision.exchange", dying)
        patch.setattr("cm.server.provision._remove", lambda _: None)
        with pytest.raises(Killed):
            provisioner.store(SCHEMA, (File("one.bit", b"new"),))
    again = Provisioner(tmp_path / "configs")
    again.recover()
    assert content(again)["one.bit"] == (b"new" if after else b"1")
    assert [p.name for p in (tmp_path / "configs").iterdir()] == ["sent"]


@pytest.mark.parametrize("number", [errno.EIO, errno.ENOSPC, errno.EDQUOT])
@pytest.mark.parametrize("lasting", [False, True])
@pytest.mark.parametrize("first", [False, True])
def test_whatever_sync_fails_the_old_one_or_the_new_one_is_there_whole_and_a_second_try_stores_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int, lasting: bool, first: bool
) -> None:
    new = (File("one.bit", b"new"),)
    for at in range(5):  # three files, the folder, and the folder that holds it
        provisioner = Provisioner(tmp_path / str(at))
        if not first:
            provisioner.store(SCHEMA, FILES)
        before = content(provisioner)
        with monkeypatch.context() as patch:
            patch.setattr(os, "fsync", failing(os.fsync, at, number, lasting))
            if at < 4:
                with pytest.raises((NoSpace, NotStored)) as refused:
                    provisioner.store(SCHEMA, new)
                assert str(tmp_path / str(at)) in str(refused.value)
            else:
                with pytest.raises(NotStored, match="not known until the manager starts again"):
                    provisioner.store(SCHEMA, new)
        restarted = Provisioner(tmp_path / str(at))
        restarted.recover()
        assert content(restarted) == content(provisioner) == before
        assert set(provisioner.owned) == set() if first else {"sent"}
        provisioner.store(SCHEMA, new)
        assert content(provisioner)["one.bit"] == b"new"


def failing(call: Callable[[int], None], at: int, number: int, lasting: bool) -> Callable[[int], None]:
    """A system call on a descriptor whose call number `at` fails, or all from there on."""
    calls = itertools.count()

    def made(descriptor: int) -> None:
        count = next(calls)
        if count == at or (lasting and count > at):
            raise OSError(number, os.strerror(number))
        call(descriptor)

    return made


def test_a_removal_that_the_disk_does_not_confirm_leaves_the_configuration_and_its_files(
    provisioner: Provisioner, monkeypatch: pytest.MonkeyPatch
) -> None:
    provisioner.store(SCHEMA, FILES)
    before = content(provisioner)
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", failing(os.fsync, 0, errno.EIO, lasting=True))
        with pytest.raises(NotStored, match=r"'sent': the disk did not confirm it \(.*/configs: Input/output error\)"):
            provisioner.remove("sent", ROOT)
    assert (content(provisioner), set(provisioner.owned)) == (before, {"sent"})
    provisioner.remove("sent", ROOT)
    assert (content(provisioner), set(provisioner.owned)) == ({}, set())


def test_a_file_system_that_exchanges_nothing_keeps_the_old_one_and_says_what_to_do(
    provisioner: Provisioner, monkeypatch: pytest.MonkeyPatch
) -> None:
    provisioner.store(SCHEMA, FILES)
    before = content(provisioner)

    def cannot(one: str, other: str) -> None:
        raise OSError(errno.EINVAL, "Invalid argument")

    with monkeypatch.context() as patch:
        patch.setattr("cm.server.provision.exchange", cannot)
        with pytest.raises(NotStored, match=r"nothing has changed: remove the old one first \(cm config remove\)"):
            provisioner.store(SCHEMA, (File("one.bit", b"new"),))
    assert content(provisioner) == before
    provisioner.remove("sent", ROOT)
    provisioner.store(SCHEMA, (File("one.bit", b"new"),))
    assert content(provisioner)["one.bit"] == b"new"


def test_if_only_signed_configurations_are_accepted_none_can_be_provisioned(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    text = "config: {name: mine, modules: {a: {}}, modes: {default: {modules: [a]}}}\n"
    assert Provisioner(tmp_path / "configs").store(text, ()).name == "mine"
    closed = Provisioner(tmp_path / "configs", unsigned=False)
    assert closed.configs() == {}
    assert "1 provisioned configurations are left out: policy.signatures requires signed" in caplog.text
    assert set(closed.owned) == {"mine"}
    with pytest.raises(InvalidRequest, match="requires signed configurations"):
        closed.store(text, ())


# ---- whose it is, and how much ------------------------------------------------------------

ANNA, BEN = Sender("uid:1", "anna"), Sender("uid:2", "ben")
ROOT = Sender("uid:0", "root", admin=True)


def named(name: str) -> str:
    return SCHEMA.replace("name: sent", f"name: {name}")


def test_the_administrators_configurations_are_never_replaced_nor_removed(provisioner: Provisioner) -> None:
    provisioner.standing({"sent": loads(SCHEMA)})
    with pytest.raises(Reserved, match="administrator"):
        provisioner.store(SCHEMA, FILES, sender=ROOT)
    with pytest.raises(Reserved, match="administrator"):
        provisioner.remove("sent", ROOT)
    assert provisioner.stored() == []


def test_what_was_sent_before_the_administrator_had_one_of_that_name_is_left_out(
    provisioner: Provisioner, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    provisioner.store(SCHEMA, FILES, sender=ANNA)
    own = loads(SCHEMA)
    provisioner.store(named("other"), (), sender=ANNA)
    standing = provisioner.standing({"sent": own})
    assert (standing["sent"], set(standing)) == (own, {"sent", "other"})
    assert "configuration sent that anna sent is left out: that name is the administrator's" in caplog.text
    example = provisioner.standing({"sent": own}, example=True)  # the shipped one may be replaced
    assert (example["sent"].source, set(example)) == (tmp_path / "configs/sent" / SCHEMA_FILE, {"sent", "other"})


def test_a_configuration_that_cannot_be_read_is_left_out_and_one_of_nobody_is_an_admins(
    provisioner: Provisioner, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    for name in ("bad", "old", ".half"):
        (tmp_path / "configs" / name).mkdir(parents=True)
        (tmp_path / "configs" / name / SCHEMA_FILE).write_text(named(name) if name == "old" else "config: [")
    (tmp_path / "configs/old/one.bit").write_bytes(b"123")
    assert set(provisioner.configs()) == {"old"}
    assert "a provisioned configuration is left out: " in caplog.text
    size = len(named("old"))
    assert provisioner.owned["old"] == Owned("", "somebody", size + 3, size)
    with pytest.raises(Forbidden, match="'old' was sent by somebody; only they and an admin may replace it"):
        provisioner.store(named("old"), (), sender=ANNA)
    provisioner.store(named("old"), (), sender=ROOT)
    assert (provisioner.owned["old"].account, provisioner.owned["old"].name) == ("uid:0", "root")


def test_only_the_sender_or_an_admin_replaces_and_removes_a_configuration(tmp_path: Path) -> None:
    for who in (ANNA, ROOT):
        provisioner = Provisioner(tmp_path / "configs")
        provisioner.store(SCHEMA, FILES, sender=ANNA)
        again = Provisioner(tmp_path / "configs")  # it reads back what it knows from the disk
        assert set(again.configs()) == {"sent"}
        assert (again.owned["sent"].name, again.owned["sent"].account) == ("anna", "uid:1")
        with pytest.raises(Forbidden, match="was sent by anna"):
            again.store(SCHEMA, FILES, sender=BEN)
        with pytest.raises(Forbidden, match="was sent by anna"):
            again.remove("sent", BEN)
        again.store(SCHEMA, (File("one.bit", b"new"),), sender=who)
        again.remove("sent", who)
        assert again.configs() == {}
        assert list((tmp_path / "configs").iterdir()) == []


def test_removing_an_unknown_configuration_lists_those_that_were_sent(provisioner: Provisioner) -> None:
    provisioner.store(SCHEMA, FILES, sender=ANNA)
    with pytest.raises(UnknownConfig, match="no client sent a configuration 'other'; there are sent"):
        provisioner.remove("other", ROOT)
    with pytest.raises(UnknownConfig):
        provisioner.remove("../sent", ROOT)


def test_clients_have_so_many_bytes_to_the_last(tmp_path: Path) -> None:
    first = Provisioner(tmp_path / "configs")
    first.store(named("a"), (), sender=ANNA)
    size = first.owned["a"].bytes
    own = len(named("a")) + 1
    provisioner = Provisioner(tmp_path / "configs", limits=replace(USUAL, provisioned_each_bytes=size + own))
    provisioner.configs()
    said = f"configuration 'b' has {own + 1} bytes; yours would have {size + own + 1} together, of {size + own}: remove"
    with pytest.raises(QuotaExceeded, match=said):
        provisioner.store(named("b"), (File("one.bit", b"12"),), sender=ANNA)
    provisioner.store(named("b"), (File("one.bit", b"1"),), sender=ANNA)
    provisioner.limits = replace(USUAL, provisioned_each_bytes=1)
    with pytest.raises(QuotaExceeded, match="yours"):
        provisioner.store(named("a"), (), sender=ANNA)


def test_quotas_per_sender_and_in_total_are_kept(tmp_path: Path) -> None:
    file = File("one.bit", bytes(10_000))
    provisioner = Provisioner(
        tmp_path / "configs", limits=replace(USUAL, provisioned_each_bytes=25_000, provisioned_bytes=40_000)
    )
    for name in ("a", "b"):
        provisioner.store(named(name), (file,), sender=ANNA)
    with pytest.raises(QuotaExceeded, match="yours would have"):
        provisioner.store(named("c"), (file,), sender=ANNA)
    provisioner.store(named("b"), (file,), sender=ANNA)  # it replaces one that counted
    provisioner.store(named("c"), (file,), sender=BEN)
    with pytest.raises(QuotaExceeded, match="all clients' would have"):
        provisioner.store(named("d"), (file,), sender=BEN)
    provisioner.remove("a", ANNA)
    provisioner.store(named("d"), (file,), sender=BEN)
    assert set(provisioner.configs()) == {"b", "c", "d"}


def long(name: str, registers: int) -> str:
    """A schema with that many registers, at 43 bytes each."""
    lines = "".join(f"          register_{i:06}: {{offset: {4 * i:#010x}}}\n" for i in range(registers))
    return named(name) + f"  mmio:\n    - base_address: 0x20000\n      registers:\n{lines}"


def test_schemas_have_a_quota_of_their_own_since_they_stay_in_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cm.server.provision.SCHEMAS_EACH", 3000)
    monkeypatch.setattr("cm.server.provision.SCHEMAS_ALL", 4000)
    provisioner = Provisioner(tmp_path / "configs")
    provisioner.store(long("a", 50), (), sender=ANNA)
    with pytest.raises(QuotaExceeded, match="schemas of yours would have"):
        provisioner.store(long("b", 50), (), sender=ANNA)
    provisioner.store(long("a", 50), (), sender=ANNA)
    with pytest.raises(QuotaExceeded, match="schemas of all clients' would have"):
        provisioner.store(long("b", 50), (), sender=BEN)
    assert set(provisioner.configs()) == {"a"}


def test_a_long_schema_is_read_without_a_search_for_garbage_in_all_that_there_is(provisioner: Provisioner) -> None:
    """All threads wait for a collection: 0.2 s for 24,000 registers, several times for each schema."""
    found: list[int] = []

    def look(phase: str, info: dict[str, int]) -> None:
        if phase == "start" and info["generation"] == 2:
            found.append(len(gc.get_objects()))

    gc.callbacks.append(look)
    try:
        kept = provisioner.store(long("a", 4000), ())
        before = len(gc.get_objects())
        provisioner.store(long("b", 4000), ())
    finally:
        gc.callbacks.remove(look)
        gc.unfreeze()
    assert len(kept.registers) == 4000
    assert len(found) <= 2  # one before each schema
    assert found[-1] <= before + 100  # and the second does not look through the first's


@pytest.mark.programs
def test_a_full_disk_changes_nothing(small_disk: Path) -> None:
    provisioner = Provisioner(small_disk / "configs")
    provisioner.store(SCHEMA, FILES, sender=ANNA)
    with pytest.raises(
        NoSpace,
        match=r"^configuration 'sent': no room on the manager.s disk \(.*one\.bit: No space.*\); nothing has changed$",
    ):
        provisioner.store(SCHEMA, (File("one.bit", bytes(4 << 20)),), sender=ANNA)
    assert content(provisioner)["one.bit"] == b"1"
    assert [p.name for p in (small_disk / "configs").iterdir()] == ["sent"]
