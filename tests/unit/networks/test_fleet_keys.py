# SPDX-License-Identifier: Apache-2.0
"""A fleet's certificates and the router's rules, checked by OpenSSL and against the policy on the wire."""

from __future__ import annotations

import base64
import json
import shutil
import stat
import subprocess
from pathlib import Path

import pytest

from cm.errors import Busy, InvalidRequest, NotFound
from cm.networks.fleet.keys import VERBS, check, command_of
from cm.networks.fleet.security.access_rules import Member, access_control, verbs_of
from cm.networks.fleet.security.certificates import hosts_of
from cm.networks.fleet.security.keys_folder import KeyFolder
from cm.server.requests import BY_KIND
from cm.server.rights.model import Role
from cm.wire.messages import requests as rq


@pytest.fixture
def keys(tmp_path: Path) -> KeyFolder:
    folder = KeyFolder(tmp_path / "keys")
    folder.router(("router.lan", "127.0.0.1"), 825)
    return folder


def test_a_members_file_is_all_that_it_needs_and_no_other_user_reads_it(keys: KeyFolder) -> None:
    path = keys.add(Member("b1", "board"), 30)
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert stat.S_IMODE((keys.folder / "ca.key").stat().st_mode) == 0o600
    settings = json.loads(path.read_text())
    assert settings["connect"]["endpoints"] == ["tls/router.lan:7447"]
    assert settings["metadata"]["name"] == "b1"


@pytest.mark.skipif(shutil.which("openssl") is None, reason="needs openssl")
def test_openssl_takes_the_certificates_for_both_ends(keys: KeyFolder, tmp_path: Path) -> None:
    path = keys.add(Member("b1", "board"), 30)
    tls = json.loads(path.read_text())["transport"]["link"]["tls"]
    certificate = tmp_path / "b1.pem"
    certificate.write_bytes(base64.b64decode(tls["connect_certificate_base64"]))
    for purpose in ("sslclient", "sslserver"):
        command = [
            "openssl",
            "verify",
            "-x509_strict",
            "-purpose",
            purpose,
            "-CAfile",
            keys.folder / "ca.pem",
            certificate,
        ]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
    shown = subprocess.run(
        ["openssl", "x509", "-noout", "-subject", "-in", certificate], capture_output=True, text=True, check=True
    )
    assert shown.stdout.strip().replace(" ", "") == "subject=CN=b1"


def test_the_routers_rules_follow_the_members(keys: KeyFolder) -> None:
    def subjects() -> set[str]:
        control = json.loads((keys.folder / "router.json5").read_text())["access_control"]
        assert (control["enabled"], control["default_permission"]) == (True, "deny")
        return {name for subject in control["subjects"] for name in subject["cert_common_names"]}

    assert subjects() == {"nobody"}
    keys.add(Member("b1", "board"), 30)
    keys.add(Member("anna", "client", "operate"), 30)
    assert subjects() == {"b1", "anna"}
    keys.remove("anna")
    assert subjects() == {"b1"}
    with pytest.raises(NotFound, match="nobody has the name anna; there are b1"):
        keys.remove("anna")


def test_a_name_belongs_to_one_member_only(keys: KeyFolder) -> None:
    keys.add(Member("b1", "board"), 30)
    with pytest.raises(Busy, match="b1 has a certificate already"):
        keys.add(Member("b1", "client", "operate"), 30)
    for name in ("router", "nobody", "ca", "a/b", "é"):
        with pytest.raises(InvalidRequest):
            keys.add(Member(name, "board"), 30)
    with pytest.raises(InvalidRequest, match="one of observe, operate, provision"):
        keys.add(Member("x", "client", "admin"), 30)


def test_the_router_is_given_further_names_and_days_and_its_members_keep_their_files(keys: KeyFolder) -> None:
    path, authority = keys.add(Member("b1", "board"), 30), (keys.folder / "ca.pem").read_bytes()
    before = path.read_bytes()
    tls = json.loads(keys.router(("fd00::1", "router.lan"), 900).read_text())["transport"]["link"]["tls"]
    names = ("router.lan", "127.0.0.1", "fd00::1", "router")
    assert hosts_of(base64.b64decode(tls["listen_certificate_base64"])) == names
    assert (path.read_bytes(), (keys.folder / "ca.pem").read_bytes()) == (before, authority)
    assert "b1" in (keys.folder / "router.json5").read_text()
    for port, store in ((7448, ""), (None, "https://etcd1:2379")):
        with pytest.raises(Busy, match="has the keys of a fleet already, whose files name port 7447: make another"):
            keys.router((), 30, port, store)


@pytest.mark.parametrize("host", ["fleet.lan:7447", "böse.lan", "a b", "tls/fleet.lan", "-x", "*.lan", ""])
def test_what_is_no_host_is_refused_and_leaves_nothing(host: str, tmp_path: Path) -> None:
    with pytest.raises(InvalidRequest, match="or an address, is wanted, without a port"):
        KeyFolder(tmp_path / "k").router(("fleet.lan", host), 30)
    assert not (tmp_path / "k").exists()
    KeyFolder(tmp_path / "six").router(("fd00::1",), 30)
    member = KeyFolder(tmp_path / "six").add(Member("b1", "board"), 30)
    assert json.loads(member.read_text())["connect"]["endpoints"] == ["tls/[fd00::1]:7447"]


def queried(control: dict[str, list[dict[str, list[str]]]]) -> set[str]:
    """The queries that its members may make."""
    rules = [rule for rule in control["rules"] if "query" in rule["messages"] and rule["flows"] == ["ingress"]]
    return {key for rule in rules for key in rule["key_exprs"]}


def test_an_observer_asks_for_no_command_and_an_operator_in_its_own_name_only() -> None:
    observer = queried(access_control([Member("olga", "client")]))
    assert not {key for key in observer if "/do/" in key}
    assert "cm-store/get/olga" in observer
    assert not any(key.startswith("cm-store/txn") for key in observer)
    operator = {key for key in queried(access_control([Member("anna", "client", "operate")])) if "/do/" in key}
    assert operator == {f"cm/*/do/{verb}/anna" for verb in verbs_of("operate")}
    assert "cm/*/do/bundle/anna" not in operator
    narrow = queried(access_control([Member("bob", "client", "operate", ("b1",))]))
    assert all(key.startswith("cm/b1/") or key == "cm-store/get/bob" for key in narrow)


REQUESTS = {
    "mode": rq.ChangeMode(),
    "provision": rq.Provision(""),
    "reg": rq.WriteReg(()),
    "stream": rq.ConfigureStream("a"),
    "data": rq.WriteData("a", b""),
    "lease": rq.TakeLease(),
    "upload": rq.Upload("a", 1, offset=0, data=b""),
}


@pytest.mark.parametrize("verb", REQUESTS)
def test_a_command_takes_the_role_at_the_router_that_it_takes_on_the_wire(verb: str) -> None:
    assert BY_KIND[type(REQUESTS[verb])].right.least.role is Role[VERBS[verb].role.upper()]
    assert VERBS[verb].topic.decode() == BY_KIND[type(REQUESTS[verb])].right.least.topic


def test_names_that_cannot_be_parts_of_keys_are_refused_in_words() -> None:
    for name in ("", "a/b", "a*", "@a", "x" * 65, "a\n", "a?b", "a#", "$a"):
        with pytest.raises(InvalidRequest):
            check(name, "board")
    with pytest.raises(InvalidRequest, match="caller 'a b' must not have a space in it"):
        check("a b", "caller")
    assert check("line1-b.2", "board") == "line1-b.2"


def test_a_command_has_one_verb_and_at_most_one_caller() -> None:
    assert command_of("cm/*/do/mode/anna") == ("mode", "anna")
    for key in ("cm/**", "cm/b1/do/*/anna", "cm/b1/do/mode/*", "cm/b1/reg/do", "cm/b1/do/mode/anna/x"):
        assert command_of(key) is None
