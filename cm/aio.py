# SPDX-License-Identifier: Apache-2.0
"""The asyncio client: `cm.client.aio` under the name that users write."""

from __future__ import annotations

from cm.client.aio import Board, connect

__all__ = ["Board", "connect"]
