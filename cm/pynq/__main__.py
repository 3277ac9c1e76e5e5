# SPDX-License-Identifier: Apache-2.0
"""``python -m cm.pynq program.py [ARGUMENT…]``: run a program in which ``import pynq`` means this package."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

from cm.pynq.alias import install


def main() -> None:
    """Run the program that the command line names, as ``python program.py`` would."""
    if len(sys.argv) < 2:
        sys.exit("usage: python -m cm.pynq program.py [ARGUMENT...]")
    program = Path(sys.argv[1])
    if not program.is_file():
        sys.exit(f"{program}: there is no such program")
    try:
        install()
    except ImportError as error:
        sys.exit(str(error))
    sys.argv = sys.argv[1:]
    sys.path[0] = str(program.resolve().parent)
    runpy.run_path(str(program), run_name="__main__")


if __name__ == "__main__":
    main()
