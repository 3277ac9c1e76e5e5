# SPDX-License-Identifier: Apache-2.0
"""Helpers of the build tool's unit tests serve here too."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "unit"))
