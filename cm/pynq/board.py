# SPDX-License-Identifier: Apache-2.0
"""The one board of a program: PYNQ's calls name none."""

from __future__ import annotations

from functools import cache

from cm.client.board import Board, connect
from cm.client.places import Places
from cm.client.writer import Transfers


@cache
def board() -> Board:
    """The board, connected at the first use: that of `$CM_CONNECT`, or of this machine."""
    return connect()


@cache
def opened() -> dict[str, Transfers]:
    """The channels of DMAs on which this program has transferred something, by stream."""
    return {}


@cache
def places() -> Places:
    """The words of the board."""
    return Places(board())
