# SPDX-License-Identifier: Apache-2.0
"""The one board of a program: PYNQ's calls name none."""

from __future__ import annotations

import re
from functools import cache
from typing import Any

from cm.client.board import Board, connect
from cm.client.places import Places
from cm.client.writer import Transfers


@cache
def board() -> Board:
    """The board, connected at the first use: that of `$CM_CONNECT`, or of this machine."""
    return connect()


@cache
def places() -> Places:
    """The words of the board."""
    return Places(board())


@cache
def opened() -> dict[str, Transfers]:
    """The channels of DMAs on which this program has transferred something, by stream."""
    return {}


class _Clocks(type):
    def __getattr__(cls, name: str) -> float:
        found = re.fullmatch(r"(?:fclk|pl)(\d)_mhz", name)
        if found is None:
            raise AttributeError(f"Clocks has no {name!r}: it has fclk0_mhz to fclk3_mhz")
        for clock in board().status.clocks:
            if clock.name in (f"fclk{found[1]}", f"pl{found[1]}"):
                return (clock.rate or clock.wanted) / 1e6
        raise AttributeError(f"the loaded configuration has no clock {found[1]}")

    def __setattr__(cls, name: str, value: Any) -> None:
        raise NotImplementedError(
            f"Clocks.{name} = {value}: a rate belongs to the configuration (`clocks:` of its schema), which sets it "
            "with each load"
        )


class Clocks(metaclass=_Clocks):
    """``Clocks.fclk0_mhz`` and so on, in MHz. Setting one raises NotImplementedError."""
