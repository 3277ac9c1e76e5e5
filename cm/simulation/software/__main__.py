# SPDX-License-Identifier: Apache-2.0
"""``python -m cm.simulation.software``."""

import sys

from cm.simulation.software.process.main import main

sys.exit(main())
