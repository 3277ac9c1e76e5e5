# SPDX-License-Identifier: Apache-2.0
"""The board of the tests: what its service says, and how one reaches it from here."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TypeVar

from vmboard.booted import COMMAND_S, Booted
from vmboard.errors import VmError
from vmboard.remote import free_ports

import cm

RELEASE = "/opt/cm/release"
_T = TypeVar("_T")


class Board:
    """The board with the service on it."""

    def __init__(self, booted: Booted, port: int, folder: Path) -> None:
        self.booted, self.port, self._folder = booted, port, folder
        self.do, self.run = booted.do, booted.run

    @property
    def patience(self) -> float:
        """Seconds for one step."""
        return COMMAND_S * self.booted.machine.slow

    def until(self, condition: Callable[[], _T]) -> _T:
        """Poll for what nothing announces; returns the first true value."""
        end = time.monotonic() + self.patience
        while time.monotonic() < end:
            value = condition()
            if value:
                return value
            time.sleep(0.2)
        raise AssertionError("the condition did not come true in time")

    def start(self, *arguments: str) -> None:
        """Boot, and mount the disk with the artefacts."""
        self.booted.boot(*arguments)
        self.do("mount -o ro /dev/disk/by-id/virtio-cm-payload /opt/cm")

    def unit(self, name: str) -> str:
        """A property of the unit, as systemd tells it."""
        return self.do(f"systemctl show --value -p {name} cm").strip()

    @property
    def loads(self) -> int:
        """Bitstreams that the configuration port has taken since the boot."""
        return int(self.do("cat /sys/kernel/debug/cm_plsim/*/icap/loads"), 0)

    def keys(self, client: str) -> Path:
        """A client's key file, carried from the board to here."""
        here = self._folder / f"{client}.key"
        here.touch(0o600)
        here.write_text(self.do(f"cat /etc/cm/keys/{client}.key"))
        return here

    def twin(self, name: str) -> Board:
        """Another board with the disk that this one would have if its power went now; switched off."""
        first = free_ports(lane=9)  # that of a board without forwards
        ports = {first + index: there for index, there in enumerate(self.booted.machine.forwards.values())}
        return Board(self.booted.twin(self._folder / name, ports), first, self._folder)

    def close(self) -> None:
        """Keep the journal, and switch off."""
        with suppress(VmError):  # it was never on
            (self.booted.console.parent / "journal").write_text(self.run("journalctl -b --no-pager").said)
        self.booted.close()

    def connected(self, keys: Path | None) -> cm.Board:
        """A connection from this machine."""
        return cm.connect(f"tcp://127.0.0.1:{self.port}", keys=keys, timeout=self.patience)
