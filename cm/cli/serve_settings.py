# SPDX-License-Identifier: Apache-2.0
"""The settings of `cm serve`: those of the settings file, overridden by the options that are given."""

from __future__ import annotations

import argparse
import grp
import os
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cm.errors import CmError, InvalidRequest
from cm.frozen import replace
from cm.home import state_home
from cm.server.rights.keys import FOLDER
from cm.server.settings.model import FILE as SETTINGS_FILE
from cm.server.settings.model import Settings as Defaults
from cm.wire.topics import split_tcp

if TYPE_CHECKING:
    from cm.schema.model import Config
    from cm.server.options import Reloaded
    from cm.server.rights.model import Access, AuthorizedKey, Security
    from cm.server.settings.model import Settings

Stamps = dict[str, tuple[int, int, int]]
_LOCAL = ("127.0.0.1", "localhost", "[::1]")


class InsecureListen(CmError):
    """Listening for everybody without keys was not requested explicitly."""

    code = "insecure_listen"


def settings_of(args: argparse.Namespace) -> Settings | None:
    """The settings in effect: those of a file, overridden by the flags. None: there is no file.

    The system's file is read unless another is named or the board is simulated.
    """
    path: Path | None = args.settings
    if path is None and (args.sim or not SETTINGS_FILE.exists()):
        return None
    from cm.server.settings.loader import load_settings

    settings = load_settings(path or SETTINGS_FILE)
    given = {name: value for name, value in _flags(args).items() if value not in (None, (), "", False)}
    return replace(settings, **given)


def _flags(args: argparse.Namespace) -> dict[str, Any]:
    return {
        "listen": tuple(args.listen),
        "keys": args.keys,
        "insecure": args.insecure,
        "load": args.load,
        "runtime_dir": args.runtime_dir,
        "state_dir": args.state_dir,
    }


def configs_of(paths: Sequence[Path], settings: Settings | None) -> tuple[dict[str, Config], tuple[str, ...]]:
    """The configurations of ``--config``, or else those along the settings' search path; and what was left out.

    A schema named on the command line must be valid; one on the search path may be left out.
    """
    left_out: tuple[str, ...] = ()
    if not paths and settings is not None:
        from cm.server.settings.config_search import find_configs

        along = find_configs(settings.configs)
        configs, left_out = along.configs, along.left_out
    else:
        configs = load_configs(paths)
    if settings is None or settings.policy.signatures == "off":
        return configs, left_out
    from cm.cli.signature_policy import policy_of, signed_only

    signed, told = signed_only(configs, policy_of(settings))
    return signed, (*left_out, *told)


def load_configs(paths: Sequence[Path]) -> dict[str, Config]:
    """Every configuration of `paths`, files and folders. Raises InvalidRequest for two with one name."""
    from cm.schema import load, load_folder

    found: dict[str, Config] = {}
    for path in paths:
        new = load_folder(path) if path.is_dir() else {c.name: c for c in [load(path)]}
        twice = found.keys() & new.keys()
        if twice:
            raise InvalidRequest(f"configuration {min(twice)!r} comes twice, the second time from {path}")
        found.update(new)
    return found


def security_of(listen: Sequence[str], keys: Path | None, insecure: bool) -> Security | None:
    """The keys, if there are any. Raises InsecureListen if others could reach the board without keys."""
    if keys:
        from cm.server.rights.keys import load_server_keys

        return load_server_keys(keys)
    for address in listen:
        host, _ = split_tcp(address)
        if not insecure:
            who = "every user of this machine" if host in _LOCAL else "anybody who reaches it"
            raise InsecureListen(
                f"{address}: {who} could change the hardware; "
                "make keys ('cm keygen') and give --keys, or say --insecure"
            )
    return None


def access_of(settings: Settings | None, keys: Path | None) -> tuple[Access, tuple[str, ...]]:
    """Who may do what, and a sentence for each key that was left out."""
    said = (settings or Defaults()).access
    known: tuple[AuthorizedKey, ...] = ()
    left_out: tuple[str, ...] = ()
    if keys:
        from cm.server.rights.keys import authorized_keys

        known, left_out = authorized_keys(keys, said.keys_folder)
    policy = replace(said, keys=known, keys_folder=None)
    roles = {role for key in known for role in key.roles} - policy.names
    notes = tuple(f"no role {role!r}, which a key names: it gives no right" for role in sorted(roles))
    return policy, (*left_out, *notes)


def group_of(settings: Settings | None) -> int | None:
    """The group of the runtime folder. Raises InvalidRequest for an unknown group."""
    name = (settings or Defaults()).access.group
    if not name:
        return None
    try:
        return int(name) if name.isdecimal() else grp.getgrnam(name).gr_gid
    except KeyError:
        raise InvalidRequest(f"access.group: this system has no group {name!r}") from None


def default_state_dir(runtime: Path, sim: bool) -> Path:
    """Where the state lies by default: with the board where that is simulated, else what the service
    manager made for us, the system's folder, or the user's."""
    if sim:
        return runtime / "state"
    given = os.environ.get("STATE_DIRECTORY", "").split(":")[0]  # systemd.exec(5)
    if given:
        return Path(given)
    if os.geteuid() == 0:
        return Path("/var/lib/cm")
    return state_home() / "cm"


def default_runtime_dir() -> Path:
    """Where the sockets lie by default: what the service manager made for us, or else where clients look for it."""
    given = os.environ.get("RUNTIME_DIRECTORY", "").split(":")[0]
    if given:
        return Path(given)
    from cm.client.find_manager import default_runtime_dir as clients_default

    return clients_default()


def read_again(args: argparse.Namespace, paths: Sequence[Path], began: Settings | None) -> Reloaded:
    """What a reload finds: schemas and keys as they are now. Raises CmError, OSError.

    `began`: the settings of the start; changes in them that need a restart are noted.
    """
    from cm.server.options import Reloaded
    from cm.server.settings.model import Limits

    settings = settings_of(args)
    configs, left_out = configs_of(paths, settings)
    listen, keys, insecure = secure_as(args, settings)
    security_of(listen, keys, insecure)
    access, notes = access_of(settings, keys)
    said, notes = (
        settings or Defaults(),
        (*notes, *left_out, *_needs_restart(began, settings)),
    )
    return Reloaded(configs, access, Limits.of(said.limits), notes, not left_out)


def stamps(args: argparse.Namespace, began: Settings | None) -> Stamps:
    """What changes when the settings or the keys do: their files, with inode, size and time."""
    keys = began.keys if began else args.keys
    folders = []
    if keys:
        folders = [keys, (began and began.access.keys_folder) or keys.parent / FOLDER]
    settings = args.settings or (SETTINGS_FILE if began else None)
    found = {}
    for path in [*([settings] if settings else []), *folders, *(f for x in folders[1:] for f in x.glob("*.pub"))]:
        with suppress(OSError):
            status = path.stat()
            found[str(path)] = status.st_ino, status.st_size, status.st_mtime_ns
    return found


def secure_as(args: argparse.Namespace, settings: Settings | None) -> tuple[Sequence[str], Path | None, bool]:
    """Addresses, key file and whether it is fine without, by flags or settings."""
    source = settings or args
    return source.listen, source.keys, source.insecure


def _needs_restart(began: Settings | None, now: Settings | None) -> tuple[str, ...]:
    if began is None or now is None:
        return ()
    names = [
        name
        for name in began.__slots__
        if name not in ("configs", "access", "limits") and getattr(began, name) != getattr(now, name)
    ]
    if began.limits.message_mib != now.limits.message_mib:  # which has to be set before sockets are bound
        names.append("limits.message_mib")
    return tuple(f"settings: {name} has changed; it counts after a restart" for name in names)
