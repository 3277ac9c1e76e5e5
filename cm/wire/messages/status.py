# SPDX-License-Identifier: Apache-2.0
"""What the configuration manager tells: its status, events and the bodies of replies.

Their classes are made of the messages in cm.proto, which say what each field means (release/message_classes.py).
"""

from __future__ import annotations

from typing import NamedTuple

from cm.wire.messages._proto import *  # noqa: F403 (all of them, under the name that users import)
from cm.wire.messages._proto import Body, ErrorInfo
from cm.wire.messages.shown import place as place

PIXEL_FORMAT = "pixel_format"  # the code of a picture's refusal, whose pixels the client then brings in order
NOTICES = ("reconciled", "slept")  # codes of what the manager has found out, where nothing failed


class Reply(NamedTuple):
    """An answer: a body, or an error; `sequence` is the status's at that time.

    `encoded`: in place of a body, its bytes as they stand in the message.
    """

    body: Body = None
    error: ErrorInfo | None = None
    sequence: int = 0
    payload: tuple[bytes | memoryview, ...] = ()
    encoded: bytes = b""
