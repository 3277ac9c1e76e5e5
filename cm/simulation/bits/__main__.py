# SPDX-License-Identifier: Apache-2.0
"""``python -m cm.simulation.bits``."""

import sys

from cm.simulation.bits.main import main

if __name__ == "__main__":
    sys.exit(main())
