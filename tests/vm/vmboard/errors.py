# SPDX-License-Identifier: Apache-2.0
"""What can go wrong, by who has to act."""

from __future__ import annotations

EXIT_MISSING = 77  # the number by which test drivers know "skipped"


class VmError(Exception):
    """Something failed; the message says what and where to look."""


class MissingError(VmError):
    """The host lacks a program, a package or a device; nothing was tested."""
