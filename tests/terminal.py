# SPDX-License-Identifier: Apache-2.0
"""A shell on a terminal, as people use it: type keys, and wait for their effect."""

from __future__ import annotations

import os
import pty
import select
import subprocess
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path


class Terminal:
    """The controlling end of a terminal; `shown`: everything that it has shown."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self.shown = ""

    def type(self, keys: str, until: Path) -> str:
        """Type, or paste, and wait until there is a file with whole lines; returns them."""
        rest = keys.encode()
        end = time.monotonic() + 240
        while not (until.exists() and until.read_text().endswith("\n")):
            assert time.monotonic() < end, self.shown
            readable, writable, _ = select.select([self._descriptor], [self._descriptor] if rest else [], [], 0.02)
            if readable:
                self.shown += os.read(self._descriptor, 4096).decode(errors="replace")
            if writable:
                rest = rest[os.write(self._descriptor, rest[:256]) :]
        return until.read_text()


@contextmanager
def on_a_terminal(arguments: Sequence[str], env: Mapping[str, str], folder: Path) -> Iterator[Terminal]:
    """A shell's terminal; the shell ends with it."""
    outer, inner = pty.openpty()
    shell = subprocess.Popen(
        arguments, stdin=inner, stdout=inner, stderr=inner, env=env, cwd=folder, start_new_session=True
    )
    os.close(inner)
    try:
        yield Terminal(outer)
    finally:
        shell.kill()
        shell.wait()
        os.close(outer)
