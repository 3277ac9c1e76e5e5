# SPDX-License-Identifier: Apache-2.0
"""Archives, named by their hash: offered by their sender, fetched by boards in pieces that suit the link."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from cm.errors import CmError, NotFound
from cm.networks.fleet import keys
from cm.networks.fleet.zenoh_session import zenoh_module
from cm.wire.messages.fleet import FetchBundle

_BLOCK = 1 << 20  # bytes that are read at once
_LEAST, _MOST = 5 << 9, 1 << 18  # bytes of a piece
_WORDS = 250  # bytes of the fleet's that may come behind a piece, of a change before which no further one is asked for
_WORTH = 0.2  # seconds that a piece takes; one is under way at a time
_TIMEOUT = 20.0  # seconds for a piece
PATIENCE = 10.0  # seconds until all routers know a sender
_BETWEEN_TRIES = 0.1  # seconds


class BundleMissing(CmError):
    """An archive is offered by nobody, or what has come is another."""

    code = "bundle_missing"


def described(archive: Path) -> FetchBundle:
    """The request to fetch an archive. Raises NotFound, OSError."""
    if not archive.is_file():
        raise NotFound(f"{archive}: there is no such file")
    return FetchBundle(_hash(archive), archive.stat().st_size, archive.name)


def _hash(path: Path) -> str:
    whole = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(_BLOCK):
            whole.update(block)
    return whole.hexdigest()


def where(sha256: str) -> str:
    """The key of an archive, short, as each piece is asked for by it and comes under it."""
    return f"{keys.BUNDLES}/origin/{sha256[:16]}"


@contextmanager
def offered(session: Any, archive: Path, bundle: FetchBundle) -> Iterator[Callable[[], int]]:
    """Serve pieces of an archive; gives a function that says how many bytes have been sent so far."""
    sent = [0]

    def answer(query: Any) -> None:
        with query, archive.open("rb") as file:
            file.seek(int(query.parameters.get("from", "0")))
            data = file.read(max(0, min(int(query.parameters.get("length", "0")), _MOST)))
            sent[0] += len(data)
            query.reply(str(query.key_expr), data)

    queryable = session.declare_queryable(where(bundle.sha256), answer, complete=True)
    try:
        yield lambda: sent[0]
    finally:
        queryable.undeclare()


def fetched(
    session: Any, bundle: FetchBundle, path: Path, patience: float = PATIENCE, busy: Callable[[], bool] = lambda: False
) -> None:
    """Append to a file what it has not of an archive, piece by piece as they come, and check the whole.

    The sender has only just begun, and routers learn of it one after the other: an unanswered query is repeated for
    `patience` seconds. Nothing is asked for while `busy`. Raises BundleMissing, OSError; pieces that have come are
    kept, and not fetched again, unless they do not make the archive.
    """
    pace, end = Pace(), time.monotonic() + patience
    last_in_line = zenoh_module().Priority.BACKGROUND  # the fleet's own words go first; answers have it, too
    with path.open("ab") as file:
        while (at := file.tell()) < bundle.length:
            while busy():
                time.sleep(_BETWEEN_TRIES)
            length, begun = min(pace.length, bundle.length - at), time.monotonic()
            asked = f"{where(bundle.sha256)}?from={at};length={length}"
            replies = session.get(asked, timeout=_TIMEOUT, priority=last_in_line)
            data = next((bytes(reply.ok.payload) for reply in replies if reply.ok is not None), b"")
            if len(data) == length:
                file.write(data)
                file.flush()
                seconds = time.monotonic() - begun
                pace.took(length, seconds)
                time.sleep(seconds * _WORDS / length)
                end = time.monotonic() + patience
            elif time.monotonic() > end:
                raise BundleMissing(f"{bundle.name}: nobody offers it any more ({at} bytes are here)")
            else:
                time.sleep(_BETWEEN_TRIES)
    if _hash(path) != bundle.sha256:
        path.unlink()
        raise BundleMissing(f"{bundle.name}: what has come is not the archive that was announced: push it again")


class Pace:
    """How long a piece may be: what comes in a fifth of a second, as far as that is known."""

    def __init__(self) -> None:
        self.length = _LEAST

    def took(self, length: int, seconds: float) -> None:
        """A piece of that length has come; the next is twice as long at most."""
        fits = int(length / max(seconds, 1e-6) * _WORTH)
        self.length = max(_LEAST, min(fits, 2 * self.length, _MOST))
