# SPDX-License-Identifier: Apache-2.0
"""``python -m cm.simulation.software``."""

import os
import sys

from cm.simulation.software.process.main import main

status = main()
sys.stdout.flush()
sys.stderr.flush()
os._exit(status)  # all is closed: to take the interpreter apart takes longer than the rest of the end
