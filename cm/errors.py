# SPDX-License-Identifier: Apache-2.0
"""The exceptions of the whole package.

Every error that a user can meet has a stable ``code``: the string that travels in a reply
(`Error.code` of cm.proto), stands in ``--json`` output and in ``docs/reconfiguration.md``.
Subpackages subclass `CmError`; they never raise a bare builtin for a condition of the field.
"""

from __future__ import annotations

from typing import ClassVar


class CmError(Exception):
    """Base of all errors; ``code`` is stable, the sentence is for people."""

    code: ClassVar[str] = "internal"


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
