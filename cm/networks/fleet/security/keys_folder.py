# SPDX-License-Identifier: Apache-2.0
"""The folder of ``cm fleet keys``: the authority, the list of members, and a file of zenoh's settings for each.

A member's file holds its key, its certificate and where the router is: it is all that the member needs, and nobody
else may read it. The router's file has the rules, and is written anew with each change of the members.
"""

from __future__ import annotations

import base64
import json
import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from cm.errors import Busy, InvalidRequest, NotFound
from cm.networks.fleet import keys
from cm.networks.fleet.security.access_rules import Member, access_control, verbs_of
from cm.networks.fleet.security.certificates import Identity, authority, hosts_of, issued
from cm.networks.fleet.zenoh_session import PORT

_MEMBERS, _CA, _CA_KEY, ROUTER = "members.json", "ca.pem", "ca.key", "router"
_RESERVED = frozenset(("ca", ROUTER, "members", keys.NOBODY))


@dataclass(frozen=True, slots=True)
class KeyFolder:
    """One fleet's."""

    folder: Path

    # ---- what it is asked for ---------------------------------------------------------------

    def router(self, hosts: tuple[str, ...], days: int, port: int | None = None, store: str = "") -> Path:
        """The router's file: of a new fleet, or anew of the one that is here, whose members keep their files.

        `hosts`: names by which the router is reached, those of its certificate so far stay; members connect to the
        first. `port` (PORT), and `store`, where the wanted state is, are in the members' files: raises Busy for
        others than theirs. Raises InvalidRequest.
        """
        if (self.folder / _MEMBERS).exists():
            return self._renewed(hosts, days, port, store)
        if not hosts:
            raise InvalidRequest("say by which --host names or addresses the router is reached")
        ca, port = authority(f"cm fleet of {hosts[0]}"), PORT if port is None else port
        settings = {
            "mode": "router",
            "listen": {"endpoints": [f"tls/[::]:{port}"]},
            "scouting": {"multicast": {"enabled": False}},
            "transport": {"link": {"tls": _tls("listen", issued(ca, ROUTER, days, hosts), ca.certificate)}},
        }
        self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        _write(self.folder / _CA_KEY, ca.key, 0o600)
        _write(self.folder / _CA, ca.certificate, 0o644)
        _write(self._router, _json(settings), 0o600)
        host = f"[{hosts[0]}]" if ":" in hosts[0] else hosts[0]
        self._save({"router": f"tls/{host}:{port}", "store": store, "members": []})
        return self._router

    def _renewed(self, hosts: tuple[str, ...], days: int, port: int | None, store: str) -> Path:
        fleet, settings = self._load(), json.loads(self._router.read_bytes())
        at = int(fleet["router"].rpartition(":")[2])
        if port not in (None, at) or store not in ("", fleet.get("store", "")):
            where = f"port {at}" + (f" and the store {fleet['store']}" if fleet.get("store") else "")
            raise Busy(f"{self.folder} has the keys of a fleet already, whose files name {where}: make another folder")
        tls = settings["transport"]["link"]["tls"]
        before = hosts_of(base64.b64decode(tls["listen_certificate_base64"]))
        all_ = tuple(dict.fromkeys((*(host for host in before if host != ROUTER), *hosts)))
        tls |= _tls("listen", issued(self._authority(), ROUTER, days, all_), (self.folder / _CA).read_bytes())
        _write(self._router, _json(settings), 0o600)
        return self._router

    def add(self, member: Member, days: int) -> Path:
        """A certificate for a member, in a file of its own. Raises InvalidRequest, Busy for a name that is taken."""
        keys.check(member.name, member.kind)
        if member.name in _RESERVED or not member.name.isascii():
            raise InvalidRequest(f"{member.name!r} cannot be the name of a {member.kind}: take another")
        verbs_of(member.role)
        fleet = self._load()
        if member.name in {other["name"] for other in fleet["members"]}:
            raise Busy(f"{member.name} has a certificate already; `remove` it first, and it is worth nothing any more")
        ca = self._authority()
        where = {"store": fleet["store"]} if fleet.get("store") else {}
        settings: dict[str, Any] = {
            "mode": "client",
            "metadata": {"name": member.name, "kind": member.kind, **where},
            "connect": {"endpoints": [fleet["router"]], "timeout_ms": 3000},
            "scouting": {"multicast": {"enabled": False}},
            "transport": {"link": {"tls": _tls("connect", issued(ca, member.name, days), ca.certificate)}},
        }
        path = self.folder / f"{member.name}.json5"
        _write(path, _json(settings), 0o600)
        self._save({**fleet, "members": [*fleet["members"], asdict(member)]})
        return path

    def remove(self, name: str) -> None:
        """Remove a member's rights: its certificate then means nothing to the router. Raises NotFound."""
        fleet = self._load()
        names = [member["name"] for member in fleet["members"]]
        if name not in names:
            raise NotFound(f"nobody has the name {name}; there are {', '.join(names) or 'none'}")
        self._save({**fleet, "members": [member for member in fleet["members"] if member["name"] != name]})
        (self.folder / f"{name}.json5").unlink(missing_ok=True)

    def members(self) -> tuple[Member, ...]:
        """The members that have a certificate. Raises NotFound."""
        return _members(self._load())

    # ---- files ------------------------------------------------------------------------------

    @property
    def _router(self) -> Path:
        return self.folder / f"{ROUTER}.json5"

    def _authority(self) -> Identity:
        return Identity((self.folder / _CA).read_bytes(), (self.folder / _CA_KEY).read_bytes())

    def _load(self) -> dict[str, Any]:
        try:
            return dict(json.loads((self.folder / _MEMBERS).read_text(encoding="utf-8")))
        except FileNotFoundError:
            raise NotFound(f"{self.folder} has no keys of a fleet: begin with `cm fleet keys DIR router`") from None

    def _save(self, fleet: dict[str, Any]) -> None:
        """The members, and the rules for them."""
        _write(self.folder / _MEMBERS, _json(fleet), 0o600)
        nobody = Member(keys.NOBODY, "client", boards=(keys.NOBODY,))  # gives rules before there are members
        rules = access_control(_members(fleet) or (nobody,))
        _write(self._router, _json({**json.loads(self._router.read_bytes()), "access_control": rules}), 0o600)


def _members(fleet: dict[str, Any]) -> tuple[Member, ...]:
    return tuple(Member(**{**member, "boards": tuple(member["boards"])}) for member in fleet["members"])


def _tls(end: str, identity: Identity, ca: bytes) -> dict[str, Any]:
    return {
        "enable_mtls": True,
        "root_ca_certificate_base64": _base64(ca),
        f"{end}_certificate_base64": _base64(identity.certificate),
        f"{end}_private_key_base64": _base64(identity.key),
    }


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode()


def _json(settings: dict[str, Any]) -> bytes:
    return json.dumps(settings, indent=2).encode() + b"\n"


def _write(path: Path, data: bytes, mode: int) -> None:
    """Write a file in one step; it is never readable by more users than `mode` allows."""
    aside = path.with_name(f".{path.name}.new")
    aside.unlink(missing_ok=True)
    handle = os.open(aside, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, mode)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:  # of a full disk, which names no file
        aside.unlink()
        raise OSError(error.errno, error.strerror, str(path)) from None
    aside.rename(path)
