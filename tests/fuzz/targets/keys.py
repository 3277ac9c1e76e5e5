# SPDX-License-Identifier: Apache-2.0
"""Files of authorized keys: a client's key, or InvalidRequest."""

from __future__ import annotations

from contextlib import suppress

from cm.errors import InvalidRequest
from cm.server.rights.keys import authorized, pairs_of

PACKAGES = ("cm.server.rights",)
MAX_LENGTH = 1024


def seeds() -> list[bytes]:
    key = b"public: rq:rM>}U?@Lns47E1%kR.o@n%FcmmsL/@{H8]yf7\n"
    return [key, key + b"role: observe, operate\nexpires: 2030-12-31\n", key + b"expires: 2030-12-31T10:00:00+02:00\n"]


def one(data: bytes) -> None:
    with suppress(InvalidRequest):
        key = authorized("anna", pairs_of(data.decode("utf-8", "replace")))
        assert len(key.public) == 40
        assert key.roles
