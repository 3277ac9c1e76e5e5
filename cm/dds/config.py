# SPDX-License-Identifier: Apache-2.0
"""Settings of Cyclone DDS: those of CYCLONEDDS_URI if it is set, otherwise such that no frames are lost."""

from __future__ import annotations

import logging
import os
from pathlib import Path

_LOG = logging.getLogger("cm.dds")
SHIPPED = Path(__file__).with_name("cyclonedds.xml")
_BUFFER = "/proc/sys/net/core/rmem_max"
_WANTED = 4_000_000  # bytes, as the shipped file has it
MINIMUM = '<SocketReceiveBufferSize min="4MB"/>'


def uri() -> str:
    """The value for CYCLONEDDS_URI: the one that is set, or the shipped settings as far as the kernel allows them."""
    given = os.environ.get("CYCLONEDDS_URI")
    if given is not None:
        return given
    if lets_buffers_be_large():
        return SHIPPED.as_uri()
    _LOG.warning(
        "frames of some MiB may be lost: the kernel allows a receive buffer of %d bytes; sysctl -w "
        "net.core.rmem_max=4194304 lets it be large enough", _allowed(),
    )  # fmt: skip
    text = SHIPPED.read_text("utf-8")
    return text[text.index("<CycloneDDS") :].replace(MINIMUM, "")


def lets_buffers_be_large() -> bool:
    """Whether the kernel allows a receive buffer that holds a frame of some MiB."""
    return _allowed() >= _WANTED


def _allowed() -> int:
    try:
        return int(Path(_BUFFER).read_text("ascii"))
    except (OSError, ValueError):
        return 0
