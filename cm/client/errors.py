# SPDX-License-Identifier: Apache-2.0
"""What goes wrong between a client and the manager."""

from __future__ import annotations

from cm.errors import Busy, CmError, Forbidden, InvalidRequest, NotFound, Timeout
from cm.wire.messages.status import ErrorInfo


class RequestFailed(CmError):
    """The manager refused a request or failed at it; `code` is the manager's (docs/reconfiguration.md)."""

    def __init__(self, error: ErrorInfo) -> None:
        super().__init__(error.message)
        vars(self)["code"] = error.code  # this error's own code, in place of the class's


class RequestNotFound(RequestFailed, NotFound):
    """A name that does not exist was given."""


class RequestInvalid(RequestFailed, InvalidRequest):
    """The request itself is wrong."""


class RequestBusy(RequestFailed, Busy):
    """It is in use; try again later."""


class RequestForbidden(RequestFailed, Forbidden):
    """We have no right to it."""


class RequestTimeout(RequestFailed, Timeout):
    """Something that the manager waited for did not come."""


class NotAdmitted(Forbidden):
    """The manager, or the system, does not allow us to connect."""


class NoAnswer(Timeout):
    """The manager does not answer."""

    code = "no_answer"


class ConnectionLost(CmError, ConnectionError):
    """The manager went away while a request was under way."""

    code = "connection_lost"


class BoardClosed(CmError):
    """The board was closed here, and cannot be used any more."""

    code = "closed"


class FrameReleased(CmError, ValueError):
    """The frame was given back: its memory may hold another one by now."""

    code = "frame_released"


class LateRelease(CmError):
    """A frame was given back that the manager does not count as ours."""

    code = "late_release"


class WindowRevoked(CmError):
    """The manager took a window's pages back: what was read was not the register, a write may not have reached it.

    The board is in `mode` of `config_name` now, or on its way there; both are empty where that is not known.
    """

    code = "window_revoked"

    def __init__(self, sentence: str, config_name: str = "", mode: str = "") -> None:
        super().__init__(sentence)
        self.config_name, self.mode = config_name, mode


class TransferFailed(CmError):
    """The hardware did not take a written frame."""

    code = "transfer_failed"


_BUSY = (
    "busy", "region_busy", "held_by", "stream_stopped", "no_slots", "too_much_waiting", "replies_unread",
    "module_absent", "too_many_leases", "too_much_uploaded", "lease_unwatched", "quota",
)  # fmt: skip
_INVALID = (
    "invalid_request", "access", "out_of_range", "schema", "unsupported", "too_long", "too_many", "name_too_long",
    "config_reserved", "bad_overlay", "pixel_format", "no_window",
)  # fmt: skip
_KINDS: dict[str, type[RequestFailed]] = {
    **dict.fromkeys(_BUSY, RequestBusy),
    **dict.fromkeys(_INVALID, RequestInvalid),
    "forbidden": RequestForbidden,
    **dict.fromkeys(("timeout", "step_timeout"), RequestTimeout),
    **dict.fromkeys(
        (
            "not_found",
            "device_not_found",
            "unknown_config",
            "unknown_mode",
            "unknown_region",
            "unknown_register",
            "unknown_stream",
            "unknown_memory",
            "unknown_interrupt",
            "unknown_lease",
            "unknown_upload",
            "file_missing",
        ),
        RequestNotFound,
    ),
}


def request_error(error: ErrorInfo) -> RequestFailed:
    """The exception for an error reply."""
    return _KINDS.get(error.code, RequestFailed)(error)
