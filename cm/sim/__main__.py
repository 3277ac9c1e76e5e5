# SPDX-License-Identifier: Apache-2.0
"""``python -m cm.sim``."""

import sys

from cm.sim.process.main import main

sys.exit(main())
