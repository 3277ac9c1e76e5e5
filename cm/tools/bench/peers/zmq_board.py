# SPDX-License-Identifier: Apache-2.0
"""As `zmq_reply`, but the far end reads the register too: the difference to a manager is the manager's own work."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from cm.device import Uio, find_uio
from cm.tools.bench.peers.zmq_reply import answer, near

__all__ = ["far", "near", "put_register"]

_REGISTER = "register"


def put_register(folder: Path, root: Path, address: int, width: int) -> None:
    """Say which register."""
    (folder / _REGISTER).write_text(f"{address} {width} {root}", encoding="utf-8")


def far(folder: Path, size: int, ready: Callable[[], None]) -> None:  # noqa: ARG001 (of the frames)
    """The other end."""
    address, width, root = (folder / _REGISTER).read_text(encoding="utf-8").split(" ", 2)
    info, index = find_uio(int(address), int(width) // 8, root)
    with Uio.open(info.node, root) as uio:
        offset = int(address) - uio.maps[index].address
        answer(folder, ready, lambda: uio.read(offset, int(width), index))
