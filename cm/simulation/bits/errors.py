# SPDX-License-Identifier: Apache-2.0
"""Errors when reading configured logic."""

from __future__ import annotations

from cm.errors import CmError


class BitsError(CmError):
    """Frames cannot be simulated; the text says which configured feature is not understood."""

    code = "bits_error"
