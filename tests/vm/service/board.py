# SPDX-License-Identifier: Apache-2.0
"""The board of the tests: what its service says, and how one reaches it from here."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from vmboard.booted import COMMAND_S, Booted

import cm

ROOT = Path(__file__).resolve().parents[3]
RELEASE = "/opt/cm/release"
_T = TypeVar("_T")


def documented(page: str, marker: str) -> str:
    """The block of commands of a page in which `marker` stands."""
    text = (ROOT / page).read_text()
    blocks = re.findall(r"^```sh\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    blocks += re.findall(r"(?:^ {4}.*\n)+", text, re.MULTILINE)
    found = [block for block in blocks if marker in block]
    assert len(found) == 1, f"{page} has {len(found)} blocks with {marker!r}"
    return "\n".join(line.removeprefix("    ") for line in found[0].splitlines()) + "\n"


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

    def status(self, user: str = "root") -> dict[str, object]:
        """What `cm status` tells a user."""
        told = json.loads(self.do("cm status --json", user))
        assert isinstance(told, dict)
        return told

    def keys(self, client: str) -> Path:
        """A client's key file, carried from the board to here."""
        here = self._folder / f"{client}.key"
        here.write_text(self.do(f"cat /etc/cm/keys/{client}.key"))
        here.chmod(0o600)
        return here

    def connected(self, keys: Path | None) -> cm.Board:
        """A connection from this machine."""
        return cm.connect(f"tcp://127.0.0.1:{self.port}", keys=keys, timeout=self.patience)
