# SPDX-License-Identifier: Apache-2.0
"""Archives in parts, each under its hash: offered by their sender, fetched by boards."""

from __future__ import annotations

import hashlib
import os
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cm.errors import CmError, NotFound
from cm.networks.fleet import keys
from cm.wire.messages.fleet import FetchBundle

PART = 1 << 20  # bytes
_TIMEOUT = 20.0  # seconds for a part
PATIENCE = 10.0  # seconds until all routers know a sender
_BETWEEN_TRIES = 0.1  # seconds


class PartMissing(CmError):
    """A part of an archive is offered by nobody, or does not match its hash."""

    code = "part_missing"


def described(archive: Path, part_length: int = PART) -> FetchBundle:
    """The request to fetch an archive. Raises NotFound, OSError."""
    if not archive.is_file():
        raise NotFound(f"{archive}: there is no such file")
    whole, parts, length = hashlib.sha256(), [], 0
    with archive.open("rb") as file:
        while block := file.read(part_length):
            whole.update(block)
            parts.append(hashlib.sha256(block).hexdigest())
            length += len(block)
    return FetchBundle(whole.hexdigest(), length, tuple(parts), part_length, archive.name)


def part_key(sha256: str, part: str) -> str:
    """Parts are named by their own hash, so that anyone may serve them."""
    return f"{keys.BUNDLES}/origin/{sha256}/{part}"


@contextmanager
def offered(session: Any, archive: Path, bundle: FetchBundle) -> Iterator[Callable[[], int]]:
    """Serve the parts of an archive on request; gives a function that says how many bytes have been sent so far."""
    places = {part: number * bundle.part_length for number, part in enumerate(bundle.parts)}
    sent = [0]

    def answer(query: Any) -> None:
        with query:
            part = str(query.key_expr).split("/")[-1]
            if part in places:
                with archive.open("rb") as file:
                    file.seek(places[part])
                    data = file.read(bundle.part_length)
                sent[0] += len(data)
                query.reply(str(query.key_expr), data)

    queryable = session.declare_queryable(part_key(bundle.sha256, "*"), answer, complete=True)
    try:
        yield lambda: sent[0]
    finally:
        queryable.undeclare()


def asked(session: Any, key: str, sha256: str) -> bytes | None:
    """A part from anyone who has it; None if nobody answers with one that matches the hash."""
    for reply in session.get(key, timeout=_TIMEOUT):
        data = bytes(reply.ok.payload) if reply.ok is not None else b""
        if hashlib.sha256(data).hexdigest() == sha256:
            return data
    return None


@dataclass(frozen=True, slots=True)
class Parts:
    """Parts on disk, each checked before it gets its name, so that existing ones are right even after a crash."""

    folder: Path

    def get(self, part: str) -> bytes | None:
        """A part, if it exists and still matches its name."""
        with suppress(FileNotFoundError):
            data = (self.folder / part).read_bytes()
            if hashlib.sha256(data).hexdigest() == part:
                return data
        return None

    def put(self, part: str, data: bytes) -> None:
        """Keep a part. Raises OSError."""
        self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        handle, path = tempfile.mkstemp(prefix=".new-", dir=self.folder)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            Path(path).rename(self.folder / part)
        except BaseException:
            Path(path).unlink(missing_ok=True)
            raise

    def have(self, bundle: FetchBundle) -> int:
        """How many bytes of an archive are there."""
        sizes = []
        for part in bundle.parts:
            with suppress(FileNotFoundError):
                sizes.append((self.folder / part).stat().st_size)
        return sum(sizes)

    def joined(self, bundle: FetchBundle, path: Path) -> None:
        """The archive as one file, after checking its hash. Raises PartMissing, OSError."""
        whole = hashlib.sha256()
        with path.open("wb") as file:
            for part in bundle.parts:
                data = self.get(part)
                if data is None:
                    raise PartMissing(f"{bundle.name}: part {part[:12]} is gone, or was changed on the disk")
                whole.update(data)
                file.write(data)
        if whole.hexdigest() != bundle.sha256:
            raise PartMissing(f"{bundle.name}: its parts do not make the archive that was announced (sha256)")


def fetched(session: Any, bundle: FetchBundle, parts: Parts, patience: float = PATIENCE) -> None:
    """Get from the sender what is not there yet.

    The sender has only just begun, and routers learn of it one after the other: an unanswered query is repeated for
    `patience` seconds. Raises PartMissing; parts that have come are kept, and not fetched again.
    """
    for part in bundle.parts:
        end = time.monotonic() + patience
        while parts.get(part) is None:
            data = asked(session, part_key(bundle.sha256, part), part)
            if data is not None:
                parts.put(part, data)
            elif time.monotonic() < end:
                time.sleep(_BETWEEN_TRIES)
            else:
                here = parts.have(bundle)
                raise PartMissing(f"{bundle.name}: nobody offers part {part[:12]} ({here} bytes are here)")
