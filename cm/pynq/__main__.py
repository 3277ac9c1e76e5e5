# SPDX-License-Identifier: Apache-2.0
"""``python -m cm.pynq program.py [ARGUMENT…]``: run a program in which ``import pynq`` means this package."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

from cm.pynq.alias import install

if __name__ == "__main__":
    if len(sys.argv) < 2 or not Path(sys.argv[1]).is_file():
        sys.exit(f"usage: python -m cm.pynq program.py [ARGUMENT...]; no such file: {' '.join(sys.argv[1:2])}")
    try:
        install()
    except ImportError as error:
        sys.exit(str(error))
    sys.argv = sys.argv[1:]
    sys.path[0] = str(Path(sys.argv[0]).resolve().parent)
    runpy.run_path(sys.argv[0], run_name="__main__")
