# SPDX-License-Identifier: Apache-2.0
"""``python -m cm.bits``."""

import sys

from cm.bits.main import main

if __name__ == "__main__":
    sys.exit(main())
