# SPDX-License-Identifier: Apache-2.0
"""What clients send in parts, until a request uses it: unnamed files in the state folder, mapped when used."""

from __future__ import annotations

import mmap
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import ClassVar

from cm.errors import Busy, CmError, InvalidRequest, NotFound
from cm.frozen import dataclass, replace
from cm.server.client_quotas import Client
from cm.server.sender_order import Asked
from cm.server.settings.model import Limits
from cm.wire.messages import requests as rq
from cm.wire.messages.status import UploadInfo

IDLE = 60.0  # seconds after which one is forgotten whose next part, or use, does not come
LEFT = 5.0  # the same, of a process that has ended
EACH = 256  # of one user, or key, at once: each takes a descriptor


class TooMuchUploaded(Busy):
    """A client, or all together, have sent more in parts than may be stored unused."""

    code: ClassVar[str] = "too_much_uploaded"


class UnknownUpload(NotFound):
    """There is no upload of that name, or not all of it has come."""

    code: ClassVar[str] = "unknown_upload"


class UploadFailed(CmError):
    """A part could not be stored."""

    code: ClassVar[str] = "upload_failed"


@dataclass(slots=True)
class _Upload:
    fd: int
    length: int
    until: float
    got: int = 0


class Uploads:
    """Uploads by client and name. The loop's thread."""

    def __init__(self, folder: Path, limits: Limits, total: Callable[[], int]) -> None:
        """`total`: the bytes that all clients have stored now."""
        self._folder = folder
        self._total = total
        self.limits = limits
        self._there: dict[tuple[str, str], tuple[_Upload, Client]] = {}

    def take(self, client: Client, part: rq.Upload) -> UploadInfo:
        """Store a part. Raises InvalidRequest, TooMuchUploaded, UploadFailed."""
        self.forget_old()
        key = client.name, part.id
        if part.discard:
            self._drop(key)
            return UploadInfo(part.id, part.length, 0)
        upload = self._there[key][0] if key in self._there else self._begin(key, client, part)
        if part.length != upload.length or part.offset != upload.got:
            raise InvalidRequest(
                f"upload {part.id!r}: byte {part.offset} of {part.length} where {upload.got} of {upload.length} is next"
            )
        if part.offset + len(part.data) > part.length:
            raise InvalidRequest(f"upload {part.id!r}: {len(part.data)} bytes at {part.offset} of {part.length}")
        self._check_room(client, len(part.data), part.length - upload.got)
        try:
            rest, at = memoryview(part.data), part.offset
            while rest:
                done = os.pwrite(upload.fd, rest, at)
                rest, at = rest[done:], at + done
        except OSError as error:
            self._drop(key)
            raise UploadFailed(f"upload {part.id!r} in {self._folder}: {error.strerror}") from error
        upload.got += len(part.data)
        client.upload_bytes += len(part.data)
        upload.until = time.monotonic() + IDLE
        return UploadInfo(part.id, upload.length, upload.got)

    def _begin(self, key: tuple[str, str], client: Client, part: rq.Upload) -> _Upload:
        if part.offset:
            raise UnknownUpload(f"upload {part.id!r}: there are no bytes before {part.offset}; begin with offset 0")
        if sum(other.account == client.account for _, other in self._there.values()) >= EACH:
            raise TooMuchUploaded(f"{EACH} uploads of {client.account} are stored here unused")
        self._check_room(client, len(part.data), part.length)
        upload = _Upload(self._new(part), part.length, time.monotonic() + IDLE)
        self._there[key] = upload, client
        return upload

    def _check_room(self, client: Client, more: int, rest: int) -> None:
        """Raise TooMuchUploaded: what has come counts, not what a client says that will come, unless it is hopeless."""
        own = sum(upload.got for upload, other in self._there.values() if other.account == client.account)
        most, of_all = self.limits.upload_bytes, self.limits.uploads_bytes
        if own + more > most or self._total() + more > of_all or rest > most:
            raise TooMuchUploaded(
                f"{own} bytes of {client.account} are stored here unused, {self._total()} of all; "
                f"{max(more, rest)} more are too many (limits.uploads_mib: half of it for each user)"
            )

    def _new(self, part: rq.Upload) -> int:
        import tempfile  # with shutil 1 MiB, which most managers never need

        try:
            with tempfile.TemporaryFile(dir=self._folder, buffering=0) as file:
                os.truncate(file.fileno(), part.length)
                return os.dup(file.fileno())
        except OSError as error:
            raise UploadFailed(f"upload {part.id!r} in {self._folder}: {error.strerror}") from error

    def fill_in(self, asked: Asked) -> None:
        """Give a request the bytes that were uploaded for it; they are used up once it is accepted.

        A request that is refused can be made again with them. Raises UnknownUpload.
        """
        request, client = asked.request, asked.client
        if isinstance(request, rq.WriteData) and request.upload:
            names = [request.upload]
            asked.request = replace(request, data=self._view(client, request.upload), upload="")
        elif isinstance(request, rq.Provision) and any(file.upload for file in request.files):
            names = [f.upload for f in request.files if f.upload]
            files = [replace(f, data=self._view(client, f.upload), upload="") if f.upload else f for f in request.files]
            asked.request = replace(request, files=tuple(files))
        else:
            return
        asked.if_accepted = lambda: [*map(self._drop, [(client.name, name) for name in names])]

    def _view(self, client: Client, name: str) -> memoryview:
        found = self._there.get((client.name, name))
        if found is None or found[0].got != found[0].length:
            got = f"{found[0].got} of {found[0].length} bytes are there" if found else "there is no upload of that name"
            raise UnknownUpload(f"upload {name!r}: {got}")
        try:
            upload = found[0]
            return memoryview(mmap.mmap(upload.fd, upload.length, access=mmap.ACCESS_READ) if upload.length else b"")
        except OSError as error:
            raise UploadFailed(f"upload {name!r}: {error.strerror}") from error

    def forget_old(self) -> None:
        """Forget uploads whose next part, or use, does not come."""
        now = time.monotonic()
        left = now + IDLE - LEFT
        for key, (upload, client) in list(self._there.items()):
            has_left = bool(client.pid) and not Path(f"/proc/{client.pid}").exists()
            if upload.until < (left if has_left else now):
                self._drop(key)

    def _drop(self, key: tuple[str, str]) -> None:
        found = self._there.pop(key, None)
        if found is not None:
            upload, client = found
            client.upload_bytes -= upload.got
            os.close(upload.fd)

    def close(self) -> None:
        """Forget all."""
        for key in list(self._there):
            self._drop(key)
