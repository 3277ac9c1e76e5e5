# SPDX-License-Identifier: Apache-2.0
"""What went wrong, told: to people as a sentence, to scripts as a code and a sentence, to both by the exit status."""

from __future__ import annotations

import os
import sys

from cm.cli.colours import painted
from cm.errors import CmError, sentence

EXIT_FAILED = 1  # refused or failed
EXIT_USAGE = 2
EXIT_INTERRUPTED, EXIT_PIPE = 130, 141  # Ctrl-C; a reader that went away: as shells report who died of these signals
_PACKAGES = {"data": "sim", "simulation": "sim", "design": "build", "networks": "bridge", "tools.demo": "sim"}


def failed(error: CmError | OSError, as_json: bool, place: str = "") -> int:
    """Tell it; the exit status."""
    code, sentence = code_and_sentence(error)
    return _fail(code, f"{place}{sentence}", as_json)


def not_installed(module: str, as_json: bool) -> int:
    """Tell which package has a module of ours that is missing, as distributions split the package; the exit status."""
    parts = module.split(".")
    absent = ".".join(parts[1:3]) if parts[1] == "tools" else parts[1]
    name = _PACKAGES.get(absent, absent.removeprefix("tools."))
    where = f"on Debian it is in fpga-cm-{name}, on Yocto in python3-fpga-cm-{name}"
    return _fail("not_installed", f"cm.{absent} is not installed here: {where}", as_json)


def _fail(code: str, message: str, as_json: bool) -> int:
    if as_json:
        from cm.cli.common import print_json

        print_json({"error": {"code": code, "message": message}})
    else:
        tell(code, message)
    return EXIT_FAILED


def code_and_sentence(error: CmError | OSError) -> tuple[str, str]:
    """As ``--json`` has them; the code is `io` for what the system refused."""
    if isinstance(error, CmError):
        return error.code, str(error)
    if isinstance(error, FileNotFoundError) and not str(error.filename or "").startswith("/") and _nowhere():
        return "io", "the folder in which this was called is gone: cd to one that is there"
    return "io", sentence(error)


def _nowhere() -> bool:
    try:
        os.getcwd()  # noqa: PTH109 (a command of every day does without pathlib)
    except FileNotFoundError:
        return True
    return False


def tell(code: str, message: str) -> None:
    """Tell people, on standard error."""
    named = "" if code == "io" else painted(f" [{code}]", "dim", sys.stderr)
    print(f"{painted('cm:', 'red', sys.stderr)} {message}{named}", file=sys.stderr)
