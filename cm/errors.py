# SPDX-License-Identifier: Apache-2.0
"""The exceptions of the whole package.

Every error that a user can meet has a stable ``code``: the string that travels in a reply
(`Error.code` of cm.proto), stands in ``--json`` output and in ``docs/reconfiguration.md``.
Subpackages subclass `CmError`; they never raise a bare builtin for a condition of the field.
"""

from __future__ import annotations

from typing import Any, ClassVar


class CmError(Exception):
    """Base of all errors; ``code`` is stable, the sentence is for people."""

    code: ClassVar[str] = "internal"

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickled and copied without `__init__`, which in many of them takes something else than the sentence.

        An error that cannot be unpickled ends a whole pool of processes in place of one task.
        """
        made: Any = super().__reduce__()
        return (_again, made[:2], *made[2:])


def sentence(error: Exception) -> str:
    """For people; what the system refused as ``FILE: reason``, without its number."""
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return str(error)


def _again(kind: type[CmError], arguments: tuple[Any, ...]) -> CmError:
    error = kind.__new__(kind, *arguments)
    if not error.args:  # builtin system errors leave that to their `__init__`
        error.args = arguments
    return error


class InvalidRequest(CmError, ValueError):
    """A request that could not be understood: wrong frames, wrong types, missing fields."""

    code = "invalid_request"


class NotFound(CmError, LookupError):
    """A name that does not exist was given; the sentence lists those that do."""

    code = "not_found"


class Busy(CmError):
    """The thing asked for is in use; the sentence says by whom or by what."""

    code = "busy"


class Forbidden(CmError, PermissionError):
    """The client has no right to do this; the sentence names the client and the right that it needs."""

    code = "forbidden"


class Timeout(CmError, TimeoutError):
    """A wait ended without what was waited for."""

    code = "timeout"


class NotInstalled(CmError):
    """A package that this needs is not there; the sentence says how to install it."""

    code = "not_installed"
