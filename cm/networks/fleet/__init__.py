# SPDX-License-Identifier: Apache-2.0
"""Many boards over zenoh: a client of the bridges that ``cm bridge fleet`` starts beside their managers."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cm.networks.fleet.blocking import Fleet as Fleet
    from cm.networks.fleet.blocking import connect as connect


def __getattr__(name: str) -> Any:
    """`connect` and `Fleet` when they are first used: a bridge needs neither."""
    if name in ("connect", "Fleet"):
        from cm.networks.fleet import blocking

        return getattr(blocking, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
