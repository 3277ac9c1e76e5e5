# SPDX-License-Identifier: Apache-2.0
"""Child processes that run modules of this package, and never what lies in the user's folder.

`python -m` puts the folder it is started in before all others, so that a `cm/` or a `yaml.py` there
would run instead of ours. `-P` needs Python 3.11, and `-I` drops PYTHONPATH, which users rely on.
So the child drops that entry itself, before its first import.
"""

from __future__ import annotations

import os
import select
import signal
import site
import subprocess
import sys
from pathlib import Path

# `-c` puts "" first (PYTHONSAFEPATH, or -P, does not); `sys` is built in, so no folder is searched before this runs.
# Ctrl-C, which a terminal sends to children too, ends them without a word, until they have a handler of their own.
_START = """\
import _signal, sys
_signal.signal(_signal.SIGINT, _signal.SIG_DFL)
if sys.path[:1] == [""]: del sys.path[0]
from runpy import run_module
del sys.argv[0]
run_module(sys.argv[0], run_name="__main__", alter_sys=True)
"""


def command(module: str, *arguments: str) -> list[str]:
    """The command line of ``python -m module arguments…`` without the current folder on its path.

    The module's name is a word of it, so that process lists show what runs. Start it with `environment()`.
    """
    return [sys.executable, "-c", _START, module, *arguments]


def environment() -> dict[str, str]:
    """Our environment; if the package is not installed (a work tree), the child finds it as we do.

    An installed one is found anyway: its folder on PYTHONPATH would put all installed packages before the standard
    library.
    """
    folder = str(Path(__file__).resolve().parents[1])
    if folder in (*site.getsitepackages(), site.getusersitepackages()):
        return dict(os.environ)
    paths = [folder, *filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep))]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}


def said_until(process: subprocess.Popen[bytes], words: bytes, timeout: float) -> tuple[bool, bytes]:
    """Whether a child wrote `words` to its standard error, a pipe, before it ended; and all that it wrote.

    `timeout`: seconds of silence that are too long.
    """
    assert process.stderr is not None
    said = b""
    while words not in said:
        ready, _, _ = select.select([process.stderr], [], [], timeout)
        piece = os.read(process.stderr.fileno(), 4096) if ready else b""
        if not piece:
            return False, said
        said += piece
    return True, said


def ended(process: subprocess.Popen[bytes], number: int = signal.SIGTERM, timeout: float = 60.0) -> bool:
    """End a child by a signal, unless it has ended; whether it did within `timeout` seconds, and was not killed."""
    process.send_signal(number)
    try:
        process.wait(timeout)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
        return False
    return True
