# SPDX-License-Identifier: Apache-2.0
"""What can go wrong before the RTL runs."""

from __future__ import annotations

from cm.errors import CmError


class RtlError(CmError):
    """The RTL cannot be compiled or run here; the text says why, with the HDL's file and line if there is one."""

    code = "rtl_error"


class ToolMissing(RtlError):
    """A compiler is not installed."""

    code = "tool_missing"
