# SPDX-License-Identifier: Apache-2.0
"""``python -m cm.rtl``."""

import sys

from cm.rtl.main import main

sys.exit(main())
