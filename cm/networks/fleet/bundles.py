# SPDX-License-Identifier: Apache-2.0
"""Archives in parts, each under its hash: offered by their sender, fetched by boards in pieces that suit the link."""

from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

from cm.errors import CmError, NotFound
from cm.networks.fleet import keys
from cm.networks.fleet.zenoh_session import zenoh_module
from cm.wire.messages.fleet import FetchBundle

PART = 1 << 20  # bytes that have a hash of their own
_LEAST, _MOST = 5 << 9, 1 << 18  # bytes of a piece, of which a part is made
_WORDS = 400  # bytes of the fleet's that may come behind a piece, of a change before which no further one is asked for
_WORTH = 0.2  # seconds that a piece takes; one is under way at a time
_TIMEOUT = 20.0  # seconds for a piece
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


def part_key(sha256: str, part: int | str) -> str:
    """Short, as each piece is asked for by it and comes under it. Earlier boards ask by whole hashes, of parts too."""
    return f"{keys.BUNDLES}/origin/{sha256[:16]}/{part}"


@contextmanager
def offered(session: Any, archive: Path, bundle: FetchBundle) -> Iterator[Callable[[], int]]:
    """Serve pieces of the parts of an archive; gives a function that says how many bytes have been sent so far."""
    places = {name: n * bundle.part_length for n, part in enumerate(bundle.parts) for name in (part, str(n))}
    sent = [0]

    def answer(query: Any) -> None:
        with query:
            part, words = str(query.key_expr).split("/")[-1], query.parameters
            if part in places:
                begin, length = int(words.get("from", "0")), int(words.get("length", str(bundle.part_length)))
                with archive.open("rb") as file:
                    file.seek(places[part] + begin)
                    data = file.read(max(0, min(length, bundle.part_length - begin)))
                sent[0] += len(data)
                query.reply(str(query.key_expr), data)

    where = part_key(bundle.sha256, "*"), f"{keys.BUNDLES}/origin/{bundle.sha256}/*"
    queryables = [session.declare_queryable(each, answer, complete=True) for each in where]
    try:
        yield lambda: sent[0]
    finally:
        for queryable in queryables:
            queryable.undeclare()


def fetched(
    session: Any, bundle: FetchBundle, path: Path, patience: float = PATIENCE, busy: Callable[[], bool] = lambda: False
) -> None:
    """Append to a file what it has not of an archive, piece by piece as they come, and check the whole.

    The sender has only just begun, and routers learn of it one after the other: an unanswered query is repeated for
    `patience` seconds. Nothing is asked for while `busy`. Raises PartMissing, OSError; pieces that have come are kept,
    and not fetched again, unless their part turns out to be another.
    """
    pace = Pace()
    with path.open("a+b") as file:
        for number in range(file.tell() // bundle.part_length, len(bundle.parts)):
            begin, end = number * bundle.part_length, time.monotonic() + patience
            last = min(begin + bundle.part_length, bundle.length)
            while not _is_part(file, begin, last, bundle.parts[number]):
                here = file.tell()
                if time.monotonic() > end:
                    raise PartMissing(f"{bundle.name}: nobody offers part {number} ({here} bytes are here)")
                _append(session, part_key(bundle.sha256, number), file, begin, last, pace, busy)
                if file.tell() < last:
                    end = time.monotonic() + patience if file.tell() > here else end
                    time.sleep(_BETWEEN_TRIES)
    with path.open("rb") as file:
        whole = hashlib.sha256()
        while block := file.read(PART):
            whole.update(block)
    if whole.hexdigest() != bundle.sha256:
        path.unlink()
        raise PartMissing(f"{bundle.name}: its parts do not make the archive that was announced (sha256)")


class Pace:
    """How long a piece may be: what comes in a fifth of a second, as far as that is known."""

    def __init__(self) -> None:
        self.length = _LEAST

    def took(self, length: int, seconds: float) -> None:
        """A piece of that length has come; the next is twice as long at most."""
        fits = int(length / max(seconds, 1e-6) * _WORTH)
        self.length = max(_LEAST, min(fits, 2 * self.length, _MOST))


def _is_part(file: BinaryIO, begin: int, last: int, part: str) -> bool:
    """Whether the file ends with that part; what has come of another is forgotten."""
    if file.seek(0, os.SEEK_END) < last:
        return False
    file.seek(begin)
    right = hashlib.sha256(file.read(last - begin)).hexdigest() == part
    file.truncate(last if right else begin)
    file.seek(0, os.SEEK_END)
    return right


def _append(
    session: Any, key: str, file: BinaryIO, begin: int, last: int, pace: Pace, busy: Callable[[], bool]
) -> None:
    """The pieces of a part, one after the other, until one does not come."""
    last_in_line = zenoh_module().Priority.BACKGROUND  # the fleet's own words go first; answers have it, too
    while (at := file.tell()) < last:
        while busy():
            time.sleep(_BETWEEN_TRIES)
        length, begun = min(pace.length, last - at), time.monotonic()
        where = f"{key}?from={at - begin};length={length}"
        replies = session.get(where, timeout=_TIMEOUT, priority=last_in_line)
        data = next((bytes(reply.ok.payload) for reply in replies if reply.ok is not None), b"")
        if len(data) != length:
            return
        file.write(data)
        file.flush()
        seconds = time.monotonic() - begun
        pace.took(length, seconds)
        time.sleep(seconds * _WORDS / length)
