# SPDX-License-Identifier: Apache-2.0
"""Keys of `cm serve` and `cm keygen`, and what is required before TCP is served."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from cm.cli.main import main
from cm.cli.serve_settings import InsecureListen, security_of
from cm.errors import InvalidRequest
from cm.server.rights.keys import ReadableKey, authorized_keys, load_server_keys, pairs_of
from cm.server.rights.model import Security


@pytest.fixture
def keys(tmp_path: Path) -> Path:
    """A folder with the server's key, and a client's."""
    assert main(["keygen", str(tmp_path / "keys"), "laptop", "--role", "observe,tuner", "--expires", "2030-12-31"]) == 0
    return tmp_path / "keys"


@pytest.mark.parametrize(
    ("address", "who"),
    [
        ("tcp://127.0.0.1", "every user of this machine"),
        ("tcp://127.0.0.1:5560", "every user of this machine"),
        ("tcp://localhost", "every user of this machine"),
        ("tcp://[::1]:0", "every user of this machine"),
        ("tcp://0.0.0.0", "anybody who reaches it"),
        ("tcp://127.0.0.1.example.org:1", "anybody who reaches it"),
    ],
)
def test_tcp_needs_a_key_or_an_explicit_setting_that_it_needs_none(address: str, who: str, keys: Path) -> None:
    with pytest.raises(InsecureListen, match=f"{who} could change the hardware"):
        security_of([address], None, insecure=False)
    assert security_of([address], None, insecure=True) is None
    assert security_of([address], keys / "server.key", insecure=False) is not None


def test_a_wrong_address_is_reported_as_that(keys: Path) -> None:
    with pytest.raises(InvalidRequest, match="is not tcp://"):
        security_of(["udp://127.0.0.1"], None, insecure=False)


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o620, 0o644])
def test_a_servers_key_that_others_may_read_is_refused(keys: Path, mode: int) -> None:
    file = keys / "server.key"
    said = pairs_of(file.read_text())
    assert load_server_keys(file) == Security(said["public"].encode(), said["secret"].encode())
    file.chmod(mode)
    told = rf"{file} can be read or written by others \(mode {mode:04o}\), .*: chmod 600 {file}, and make new keys"
    with pytest.raises(ReadableKey, match=told):
        load_server_keys(file)


def test_keys_written_by_keygen_can_be_read(keys: Path) -> None:
    (key,), notes = authorized_keys(keys / "server.key", None)
    assert (key.name, key.roles, key.until) == ("laptop", ("observe", "tuner"), 1924991999.0)
    assert notes == ()
    assert {oct(path.stat().st_mode & 0o777) for path in keys.rglob("*.*") if path.is_file()} == {"0o600"}


def test_keygen_refuses_an_invalid_date_before_it_writes_anything(tmp_path: Path) -> None:
    assert main(["keygen", str(tmp_path / "keys"), "laptop", "--expires", "soon"]) == 1
    assert not (tmp_path / "keys" / "laptop.key").exists()


def test_a_wrong_file_among_the_keys_is_left_out_and_named(keys: Path) -> None:
    folder = keys / "authorized_keys.d"
    (folder / "broken.pub").write_text("public: short\n")
    (folder / "binary.pub").write_bytes(bytes(range(256)))
    (folder / "again.pub").write_text((folder / "laptop.pub").read_text())
    (folder / ".hidden.pub").write_text("what an editor left")
    os.mkfifo(folder / "pipe.txt")
    found, notes = authorized_keys(keys / "server.key", None)
    assert [key.name for key in found] == ["again"]
    binary, broken, laptop = notes
    assert binary.startswith(f"{folder}/binary.pub: this key is left out: 'ascii' codec")
    assert broken.startswith(f"{folder}/broken.pub: this key is left out: it has no line 'public:' with a key")
    assert laptop == f"{folder}/laptop.pub: this key is left out: it is that of again already"


def test_a_server_without_authorized_keys_reports_it_and_runs_all_the_same(keys: Path) -> None:
    (keys / "authorized_keys.d/laptop.pub").unlink()
    found, notes = authorized_keys(keys / "server.key", None)
    assert found == ()
    said = "holds no client's key, so that no client can connect over TCP: 'cm keygen' makes one"
    assert notes == (f"{keys}/authorized_keys.d {said}",)
    assert authorized_keys(keys / "server.key", keys / "others")[1] == (f"{keys}/others {said}",)


def test_keygen_that_fails_leaves_nothing_in_the_way_of_the_next_try(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "keys"
    in_the_way = folder / "authorized_keys.d/laptop.pub"
    in_the_way.mkdir(parents=True)
    assert main(["keygen", str(folder), "laptop"]) == 1
    assert str(in_the_way) in capsys.readouterr().err
    in_the_way.rmdir()
    assert main(["keygen", str(folder), "laptop"]) == 0


CLIENTS = b"public: a\nsecret: b\nserver-public: c\n"


@pytest.mark.parametrize("held", [b"", b"\xff\xfe", b"public: a\n", b"secret: a\n", CLIENTS])
def test_keygen_and_serve_say_what_is_no_server_key(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], held: bytes
) -> None:
    (tmp_path / "server.key").write_bytes(held)
    assert main(["keygen", str(tmp_path), "laptop"]) == 1
    assert f"{tmp_path}/server.key is not a server key file" in capsys.readouterr().err
    with pytest.raises(InvalidRequest, match="is not a server key file; 'cm keygen' makes one"):
        load_server_keys(tmp_path / "server.key")
