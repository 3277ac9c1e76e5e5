# SPDX-License-Identifier: Apache-2.0
"""Configurations that arrive over the wire: a schema with its files, checked, and stored whole or not at all."""

from __future__ import annotations

import errno
import json
import logging
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from cm.device.native.folder_exchange import exchange
from cm.errors import Busy, CmError, Forbidden, InvalidRequest, sentence
from cm.frozen import dataclass, replace
from cm.hashes import sha256
from cm.manager.errors import UnknownConfig, listed
from cm.manager.planner import checked_name
from cm.schema import load, loads
from cm.schema.model import Config
from cm.schema.named_files import named_files
from cm.schema.problems import did_you_mean
from cm.server.durable_files import sync, write
from cm.server.garbage_collector import keeping
from cm.server.private_folders import private_folder
from cm.server.settings.model import USUAL, Limits
from cm.wire.messages.requests import File

SCHEMA_FILE = "schema.yaml"
MAX_BYTES = 512 << 20
SCHEMAS_EACH, SCHEMAS_ALL = 2 << 20, 4 << 20  # bytes of text of each, and of all: 10 to 15 times that in memory


class Reserved(InvalidRequest):
    """A configuration of the administrator has that name."""

    code = "config_reserved"


class NotTheirs(Forbidden):
    """A configuration that another client sent."""


class QuotaExceeded(Busy):
    """Clients' configurations may not use more space."""

    code = "quota"


class NoSpace(CmError):
    """The disk is full; nothing has changed."""

    code = "no_space"


class NotStored(CmError):
    """The disk refused; the sentence says what is there now."""

    code = "store"


@dataclass(frozen=True, slots=True)
class Sender:
    """Who sends or removes a configuration. `admin`: may do that to others' too."""

    account: str
    name: str
    admin: bool = False


OURSELVES = Sender("", "the manager", admin=True)


@dataclass(frozen=True, slots=True)
class Owned:
    """A configuration that was sent: its owner, its bytes, and how many of them are its schema."""

    account: str
    name: str
    bytes: int
    schema: int = 0


def check_paths(config: Config) -> None:
    """A schema that came over the wire names files that came with it, or the firmware folder's; no others.

    Raises InvalidRequest for an absolute path or one with '..'.
    """
    modes = (overlay for mode in config.modes.values() for overlay in mode.overlays)
    named: list[tuple[str, Path | None]] = [
        ("bitstream", config.bitstream),
        *((f"modules.{m.name}.bitstream", m.bitstream) for m in config.modules.values()),
        *((f"overlay {o.name}, file", o.file) for o in (*config.overlays, *modes)),
    ]
    for key, path in named:
        if path is not None and (path.is_absolute() or ".." in path.parts):
            raise InvalidRequest(
                f"configuration {config.name}: {key}: {path} leaves the configuration's folder; a schema that is "
                "sent names files that are sent with it, such as edge.bit"
            )


def check_files(config: Config, files: tuple[File, ...]) -> None:
    names = [checked_name(f.name) for f in files]
    if len(set(names)) != len(names) or SCHEMA_FILE in names:
        raise InvalidRequest(f"files of {config.name!r}: names must differ, and none may be {SCHEMA_FILE!r}")
    known = named_files(config)
    for name in names:
        if name not in known:
            hint = did_you_mean(name, known)
            raise InvalidRequest(f"files of {config.name!r}: the schema names no file {name!r} ({hint})")
    for file in files:
        if file.sha256 and sha256(file.data) != file.sha256.lower():
            raise InvalidRequest(f"cm_write_config: file {file.name!r} does not have the sha256 announced for it")
    if sum(len(f.data) for f in files) > MAX_BYTES:
        raise InvalidRequest(f"files of {config.name!r} have more than {MAX_BYTES >> 20} MiB together")


@contextmanager
def _stored_or_not(config: str) -> Iterator[None]:
    """What the disk refuses before a configuration stands in its place has changed nothing."""
    try:
        yield
    except CmError:  # some are an OSError too
        raise
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            raise NoSpace(
                f"configuration {config!r}: no room on the manager's disk ({sentence(error)}); nothing has changed"
            ) from error
        raise NotStored(f"configuration {config!r}: {sentence(error)}; nothing has changed") from error


_LOG = logging.getLogger("cm")

_SIGNED_ONLY = "policy.signatures requires signed configurations; bring it by `cm import archive`"
_TAKEN = "that name is the administrator's, whose configurations no client replaces"
_OWNER = ".owner"  # files that are sent have no names with this beginning


class Provisioner:
    """Keeps provisioned configurations below a folder, one subfolder each.

    All but `stored_by` and `owned` is for one thread, which reads and writes files.
    """

    def __init__(self, folder: Path, unsigned: bool = True, limits: Limits = USUAL) -> None:
        """`unsigned`: whether unsigned configurations may be used; those that come over the wire are never signed."""
        self._folder = folder
        self._unsigned = unsigned
        self.limits = limits
        self.reserved: frozenset[str] = frozenset()  # names of the administrator's configurations
        self.owned: Mapping[str, Owned] = {}

    def stored(self) -> list[Path]:
        """The schema files of all configurations that were provisioned."""
        return sorted(path for path in self._folder.glob(f"*/{SCHEMA_FILE}") if not path.parent.name.startswith("."))

    def configs(self) -> dict[str, Config]:
        """All configurations that were provisioned, by name; one that cannot be read is left out and logged."""
        found: dict[str, Config] = {}
        stored = self.stored()
        self.owned = {path.parent.name: _owned(path.parent) for path in stored}
        if stored and not self._unsigned:
            _LOG.error("%d provisioned configurations are left out: %s", len(stored), _SIGNED_ONLY)
            return found
        for path in stored:
            try:
                with keeping():
                    config = load(path)
            except CmError as error:
                _LOG.error("a provisioned configuration is left out: %s", error)
            else:
                found[config.name] = config
        return found

    def standing(self, administrators: Mapping[str, Config], example: bool = False) -> dict[str, Config]:
        """All configurations: the administrator's, and what clients sent under other names.

        `example`: the former are the shipped ones, to experiment with; those that are sent replace them.
        """
        if example:
            return {**administrators, **self.configs()}
        self.reserved = frozenset(administrators)
        sent = self.configs()
        for name in sorted(sent.keys() & administrators.keys()):
            _LOG.error("configuration %s that %s sent is left out: %s", name, self.owned[name].name, _TAKEN)
        return {**sent, **administrators}

    def store(
        self,
        schema: str,
        files: tuple[File, ...],
        allowed: Callable[[str], None] = lambda _: None,
        sender: Sender = OURSELVES,
    ) -> Config:
        """Check the schema, and put it and its files in place of any configuration of that name.

        Raises SchemaError, InvalidRequest (also if only signed ones are accepted), Reserved, NotTheirs, QuotaExceeded,
        NoSpace, NotStored, and what `allowed` raises for the configuration's name. The folder is written under another
        name and takes the old one's place in one step, so whatever fails leaves the old one or the new one.
        """
        if not self._unsigned:
            raise InvalidRequest(f"a configuration over the wire is refused: {_SIGNED_ONLY}")
        with keeping():
            config = loads(schema)
        check_paths(config)
        self._check_owner(config.name, sender)
        allowed(config.name)
        check_files(config, files)
        written = schema.encode()
        self._check_quota(config.name, len(written) + sum(len(f.data) for f in files), len(written), sender)
        with _stored_or_not(config.name):
            self._write(config.name, written, files, sender)
        place = self._folder / config.name
        self.owned = {**self.owned, config.name: _owned(place)}
        return replace(config, source=place.absolute() / SCHEMA_FILE, sha256_source=sha256(written))

    def remove(self, name: str, sender: Sender) -> None:
        """Remove a configuration that a client sent. Raises UnknownConfig, Reserved, NotTheirs, NotStored."""
        if name not in self.owned and name not in self.reserved:
            raise UnknownConfig(f"no client sent a configuration {name!r}; there are {listed(self.owned)}")
        self._check_owner(name, sender)
        place, gone = self._folder / name, self._folder / f".{name}-removed"
        with _stored_or_not(name):
            place.rename(gone)
            self._confirm(name, lambda: gone.rename(place))
        _remove(gone)
        self.owned = {known: owned for known, owned in self.owned.items() if known != name}

    def _check_owner(self, name: str, sender: Sender) -> None:
        if name in self.reserved:
            raise Reserved(f"configuration {name!r}: {_TAKEN}; send it under a name of its own")
        owned = self.owned.get(name)
        if owned is not None and not sender.admin and owned.account != sender.account:
            raise NotTheirs(f"configuration {name!r} was sent by {owned.name}; only they and an admin may replace it")

    def _check_quota(self, name: str, wanted: int, schema: int, sender: Sender) -> None:
        others = [owned for known, owned in self.owned.items() if known != name]
        own = [owned for owned in others if owned.account == sender.account]
        for whose, held, more, limit in (
            ("yours", sum(o.bytes for o in own), wanted, self.limits.provisioned_each_bytes),
            ("all clients'", sum(o.bytes for o in others), wanted, self.limits.provisioned_bytes),
            ("schemas of yours", sum(o.schema for o in own), schema, SCHEMAS_EACH),
            ("schemas of all clients'", sum(o.schema for o in others), schema, SCHEMAS_ALL),
        ):
            if held + more > limit:
                raise QuotaExceeded(
                    f"configuration {name!r} has {more} bytes; {whose} would have {held + more} together, of "
                    f"{limit}: remove some (cm config remove)"
                )

    def _write(self, name: str, schema: bytes, files: tuple[File, ...], sender: Sender) -> None:
        import tempfile  # with shutil 1 MiB, which most managers never need

        private_folder(self._folder)
        new, place = Path(tempfile.mkdtemp(prefix=f".{name}-", dir=self._folder)), self._folder / name
        try:
            write(new / SCHEMA_FILE, schema)
            write(new / _OWNER, json.dumps({"account": sender.account, "name": sender.name}).encode())
            for file in files:
                write(new / file.name, file.data)
            sync(new)
            if place.exists():
                _exchange(new, place)
                self._confirm(name, lambda: _exchange(new, place))
            else:
                new.rename(place)
                self._confirm(name, lambda: place.rename(new))
        finally:
            _remove(new)  # what it took the place of stands there now

    def _confirm(self, name: str, undo: Callable[[], object]) -> None:
        """Have the disk confirm which folder has the name. Where it does not, the step is undone as far as it goes."""
        try:
            sync(self._folder)
        except OSError as error:
            with suppress(OSError):
                undo()
            raise NotStored(
                f"configuration {name!r}: the disk did not confirm it ({sentence(error)}); whether it is the old one "
                "or the new one is not known until the manager starts again"
            ) from error

    def recover(self) -> None:
        """Drop what a kill left of a configuration on its way in or out."""
        for half in self._folder.glob(".*-*") if self._folder.exists() else ():
            _remove(half)


def _exchange(new: Path, place: Path) -> None:
    try:
        exchange(str(new), str(place))
    except OSError as error:
        if error.errno in (errno.EINVAL, errno.ENOSYS):
            raise NotStored(
                f"configuration {place.name!r}: the file system of {place.parent} cannot exchange two folders in one "
                "step (renameat2); nothing has changed: remove the old one first (cm config remove)"
            ) from error
        error.filename = str(place)
        raise


def _owned(folder: Path) -> Owned:
    """The owner of a configuration; an admin if none was noted, as by older versions."""
    try:
        said = json.loads((folder / _OWNER).read_text("utf-8"))
        account, name = str(said["account"]), str(said["name"])
    except (OSError, ValueError, LookupError, TypeError):
        account, name = "", "somebody"
    sizes = {path.name: path.stat().st_size for path in folder.iterdir()}
    return Owned(account, name, sum(sizes.values()), sizes.get(SCHEMA_FILE, 0))


def _remove(folder: Path) -> None:
    import shutil

    shutil.rmtree(folder, ignore_errors=True)
