# SPDX-License-Identifier: Apache-2.0
"""SHA-256 of what lies in memory, without OpenSSL where there is little of it.

``import hashlib`` loads OpenSSL's libcrypto, which takes some ms and 3.5 MiB. The interpreter's own SHA-256, which the
standard library falls back on, hashes a MiB in less than those ms; above that OpenSSL's is several times as fast. It
has a name of its own in each version of Python, and some are built without it: then hashlib does everything.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from importlib import import_module
from typing import Any

_LITTLE = 1 << 20
_PIECE = 1 << 16  # it keeps other threads waiting


def _built_in() -> Callable[[], Any] | None:
    for name in ("_sha2", "_sha256"):  # from Python 3.12 on, and before
        try:
            found: Callable[[], Any] = import_module(name).sha256
        except (ImportError, AttributeError):
            continue
        return found
    return None


_OWN = _built_in()


def sha256(data: bytes | memoryview) -> str:
    """In hexadecimal digits."""
    view = memoryview(data)
    if _OWN is None or view.nbytes > _LITTLE or "hashlib" in sys.modules:
        import hashlib

        return hashlib.sha256(view).hexdigest()
    found = _OWN()
    for start in range(0, view.nbytes, _PIECE):
        found.update(view[start : start + _PIECE])
    digits: str = found.hexdigest()
    return digits
