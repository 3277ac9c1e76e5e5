# SPDX-License-Identifier: Apache-2.0
"""Which port was chosen for a region whose schema leaves that open."""

from __future__ import annotations

from dataclasses import dataclass

from cm.schema.model import LoaderKind


@dataclass(frozen=True, slots=True)
class Choice:
    """A port, and why it is not the one before it in the order (empty: it is the first)."""

    kind: LoaderKind
    why: str = ""
