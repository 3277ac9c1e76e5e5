# SPDX-License-Identifier: Apache-2.0
"""The bus of one of QEMU's boards by its qtest protocol: devices are read and written, and no guest runs."""

import os
import subprocess
from typing import Self


class Bus:
    def __init__(self) -> None:
        command = [*os.environ["QEMU"].split(), "-S", "-qtest", "stdio", "-qtest-log", "none", "-display", "none"]
        command += ["-monitor", "none", "-serial", "none"]
        self._qemu = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._qemu.kill()
        self._qemu.communicate()

    def _ask(self, line: str) -> str:
        print(line, file=self._qemu.stdin, flush=True)
        for answer in self._qemu.stdout:
            if answer.startswith("OK"):
                return answer[2:].strip()
            if not answer.startswith("IRQ"):
                break
        raise SystemExit(f"{line}: QEMU does not answer")

    def read(self, address: int) -> int:
        return int(self._ask(f"readl {address:#x}"), 16)

    def write(self, address: int, value: int) -> None:
        self._ask(f"writel {address:#x} {value:#x}")

    def store(self, address: int, data: bytes) -> None:
        self._ask(f"write {address:#x} {len(data)} 0x{data.hex()}")

    def load(self, address: int, size: int) -> bytes:
        return bytes.fromhex(self._ask(f"read {address:#x} {size}").removeprefix("0x"))
