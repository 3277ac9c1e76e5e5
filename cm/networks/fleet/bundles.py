# SPDX-License-Identifier: Apache-2.0
"""Archives in parts, each under its hash: offered by their sender, fetched by boards."""

from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
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
    """A part of an archive is offered by nobody, or the parts do not make it."""

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


def fetched(session: Any, bundle: FetchBundle, path: Path, patience: float = PATIENCE) -> None:
    """Append to a file what it has not of an archive, part by part as they come, and check the whole.

    The sender has only just begun, and routers learn of it one after the other: an unanswered query is repeated for
    `patience` seconds. Raises PartMissing, OSError; parts that have come are kept, and not fetched again.
    """
    with path.open("ab") as file:
        file.truncate(file.tell() // bundle.part_length * bundle.part_length)  # one was cut short
        file.seek(0, os.SEEK_END)
        for part in bundle.parts[file.tell() // bundle.part_length :]:
            end = time.monotonic() + patience
            while (data := _asked(session, bundle, part)) is None:
                if time.monotonic() > end:
                    raise PartMissing(f"{bundle.name}: nobody offers part {part[:12]} ({file.tell()} bytes are here)")
                time.sleep(_BETWEEN_TRIES)
            file.write(data)
    with path.open("rb") as file:
        whole = hashlib.sha256()
        while block := file.read(PART):
            whole.update(block)
    if whole.hexdigest() != bundle.sha256:
        path.unlink()
        raise PartMissing(f"{bundle.name}: its parts do not make the archive that was announced (sha256)")


def _asked(session: Any, bundle: FetchBundle, part: str) -> bytes | None:
    """A part from anyone who has it; None if nobody answers with one that matches the hash."""
    for reply in session.get(part_key(bundle.sha256, part), timeout=_TIMEOUT):
        data = bytes(reply.ok.payload) if reply.ok is not None else b""
        if hashlib.sha256(data).hexdigest() == part:
            return data
    return None
