# SPDX-License-Identifier: Apache-2.0
"""What a check of a machine found, as frozen data."""

from __future__ import annotations

import enum

from cm.frozen import dataclass


class State(enum.Enum):
    """Whether something can be used; WRONG: it exists, but not as it should be."""

    OK = "ok"
    MISSING = "missing"
    DENIED = "denied"
    WRONG = "wrong"


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that was looked for; ``kind`` is uio, dma, icap, overlays, fpga_manager, module or a check's own."""

    kind: str
    name: str
    path: str
    state: State
    detail: str = ""
    advice: str = ""
