# SPDX-License-Identifier: Apache-2.0
"""``python -m cm.simulation.rtl``."""

import sys

from cm.simulation.rtl.main import main

sys.exit(main())
