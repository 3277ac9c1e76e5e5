# SPDX-License-Identifier: Apache-2.0
"""Configuration manager for adaptive FPGA systems.

`connect()` talks to a running manager; `cm.aio.connect()` is its asyncio twin; `cm.device` is the
layer below, usable without one. What is not used is not imported.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from cm._version import __version__

if TYPE_CHECKING:
    from cm import aio as aio
    from cm.client.board import Board as Board
    from cm.client.board import connect as connect
    from cm.errors import CmError as CmError

__all__ = ["Board", "CmError", "__version__", "aio", "connect"]


def __getattr__(name: str) -> Any:
    if name in ("connect", "Board"):
        from cm.client import board

        return getattr(board, name)
    if name == "aio":
        import importlib

        return importlib.import_module("cm.aio")
    if name == "CmError":
        from cm.errors import CmError

        return CmError
    raise AttributeError(f"module 'cm' has no attribute {name!r}")
