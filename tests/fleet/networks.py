# SPDX-License-Identifier: Apache-2.0
"""A network namespace for each of a fleet's machines, joined by a switch that misbehaves on command; as root."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

needs_root = pytest.mark.skipif(
    os.geteuid() != 0 or shutil.which("ip") is None or not Path("/dev/net/tun").exists(),
    reason="needs root, ip and /dev/net/tun",
)
HOST = "host"  # where the test itself is, and the router: the middle of the network
_PLAIN = {"delay": 0, "jitter": 0, "loss": 0, "reorder": 0, "double": 0, "rate": 0, "dumb": False, "deaf": False}

_OWN_MEMORY = """
mount -t tmpfs -o size=64m own /mnt
for each in /dev/shm/cm-t-*; do
    test -d "$each" && mkdir "/mnt/${each##*/}" && mount --bind "$each" "/mnt/${each##*/}"
done
mount --rbind /mnt /dev/shm
exec "$@"
"""  # zenoh takes shared memory past every switch; a manager's folder of a test is seen all the same


class Networks:
    """As a context manager; nothing of it can be reached from elsewhere."""

    def __init__(self, names: Sequence[str]) -> None:
        number = os.getpid() % 10000
        self._mark, self._net = f"cm{number:04}", f"198.18.{number % 200}"
        self._numbers = {name: 10 + at for at, name in enumerate((HOST, *names))}

    def __enter__(self) -> Networks:
        ports = {name: self._device(name) for name in self._numbers}
        command = [sys.executable, str(Path(__file__).with_name("switch.py")), *ports.values()]
        self._switch = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1)
        try:
            assert self._switch.stdout is not None
            assert self._switch.stdout.readline() == "ready\n"
            for name in self._numbers:
                self._join(name)
        except BaseException:
            self.__exit__()
            raise
        return self

    def _join(self, name: str) -> None:
        """Its device into its namespace. All know each other's addresses, so that a cut is not a matter of ARP."""
        device, inside = self._device(name), ["ip"]
        if name != HOST:
            _ip("netns", "add", self._space(name))
            _ip("link", "set", device, "netns", self._space(name))
            inside = ["ip", "-n", self._space(name)]
        others = [
            f"neigh replace {self.address(n)} lladdr {self._mac(n)} dev {device}" for n in self._numbers if n != name
        ]
        lines = (
            f"link set {device} address {self._mac(name)} addrgenmode none",
            f"addr add {self.address(name)}/24 dev {device}", f"link set {device} up", "link set lo up", *others,
        )  # fmt: skip
        subprocess.run([*inside, "-batch", "-"], input="\n".join(lines), check=True, capture_output=True, text=True)

    def __exit__(self, *_: object) -> None:
        for name in self._numbers:
            subprocess.run(["ip", "netns", "del", self._space(name)], check=False, capture_output=True)
        with self._switch as switch:  # which ends where its input does
            assert switch.stdin is not None
            switch.stdin.close()

    def _device(self, name: str) -> str:
        return f"{self._mark}{name}"[:15]

    def _space(self, name: str) -> str:
        return f"{self._mark}-{name}"

    def _mac(self, name: str) -> str:
        return f"02:00:00:00:00:{self._numbers[name]:02x}"

    def address(self, name: str = HOST) -> str:
        """Of a machine."""
        return f"{self._net}.{self._numbers[name]}"

    def inside(self, name: str) -> tuple[str, ...]:
        """What the command of a process there begins with."""
        return ("ip", "netns", "exec", self._space(name), "sh", "-c", _OWN_MEMORY, "sh")

    def set(self, name: str, **what: Any) -> dict[str, int]:
        """What the port of a machine does, or of ``*``; the frames of each so far, at the moment."""
        assert self._switch.stdin is not None
        assert self._switch.stdout is not None
        port = name if name == "*" else self._device(name)
        self._switch.stdin.write(json.dumps({"port": port, **what}) + "\n")
        found = json.loads(self._switch.stdout.readline())
        return {name: found[self._device(name)] for name in self._numbers}

    def mend(self) -> None:
        """All is as it should be."""
        self.set("*", **_PLAIN)

    def cut(self, name: str, how: str = "both") -> None:
        """Of a machine: ``out``, ``in`` or ``both`` ways."""
        self.set(name, dumb=how in ("both", "out"), deaf=how in ("both", "in"))

    def frames(self) -> int:
        """That all have sent so far."""
        return sum(self.set("*").values())


def _ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True, capture_output=True)
