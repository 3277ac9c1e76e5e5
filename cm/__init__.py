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
    from cm import device as device
    from cm import errors as errors
    from cm.client.blocks import Block as Block
    from cm.client.blocks import driver as driver
    from cm.client.board import Board as Board
    from cm.client.board import connect as connect
    from cm.client.picture import Picture as Picture
    from cm.errors import CmError as CmError

__all__ = ["Block", "Board", "CmError", "Picture", "__version__", "aio", "connect", "device", "driver", "errors"]

# name → the module that defines it, or that is it
_WHERE = {
    "Block": "cm.client.blocks",
    "Board": "cm.client.board",
    "CmError": "cm.errors",
    "Picture": "cm.client.picture",
    "aio": "cm.aio",
    "connect": "cm.client.board",
    "device": "cm.device",
    "driver": "cm.client.blocks",
    "errors": "cm.errors",
}


if not TYPE_CHECKING:  # to a type checker it would allow any name

    def __getattr__(name: str) -> Any:
        where = _WHERE.get(name)
        if where is None:
            raise AttributeError(_missing(name))
        from importlib import import_module

        module = import_module(where)
        return module if where == f"cm.{name}" else getattr(module, name)


def __dir__() -> list[str]:
    return sorted(__all__)


def _missing(name: str) -> str:
    from difflib import get_close_matches

    near = get_close_matches(name, _WHERE, 1)
    return f"module 'cm' has no attribute {name!r}" + (f"; did you mean {near[0]!r}?" if near else "")
