# SPDX-License-Identifier: Apache-2.0
"""``python -m cm`` is the command `cm`."""

import sys

from cm.cli.main import main

sys.exit(main())
