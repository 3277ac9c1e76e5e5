# SPDX-License-Identifier: Apache-2.0
"""Errors as clients get them."""

from __future__ import annotations

import logging

from cm.errors import CmError
from cm.wire.messages.status import ErrorInfo, Reply
from cm.wire.plane_packets import encode_refused

_LOG = logging.getLogger(__name__)


def error_info(error: Exception) -> ErrorInfo:
    """An exception in the form in which it travels; one that is not ours is a device's error or a defect."""
    if isinstance(error, CmError):
        return ErrorInfo(error.code, str(error))
    if isinstance(error, OSError):
        return ErrorInfo("device_error", str(error))
    return ErrorInfo("internal", f"{type(error).__name__}: {error}")


def encode_refusal(error: Exception) -> bytes:
    """What a client of the data socket is told about an error."""
    info = error_info(error)
    return encode_refused(info.code, info.message)


def refusal(error: Exception) -> Reply:
    """What a client is told about an error; a defect is logged."""
    if not isinstance(error, (CmError, OSError)):
        _LOG.error("a request failed", exc_info=error)
    return Reply(error=error_info(error))
