# SPDX-License-Identifier: Apache-2.0
"""Many boards: `cm.networks.fleet` under the name that users write."""

from __future__ import annotations

from cm.networks.fleet import aio as aio
from cm.networks.fleet.blocking import Fleet, connect

__all__ = ["Fleet", "aio", "connect"]
