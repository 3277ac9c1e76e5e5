# SPDX-License-Identifier: Apache-2.0
"""The cases run on the board, and the remote tests need one."""

import os

collect_ignore = ["cases", "guest", *([] if "CM_VM_ENDPOINT" in os.environ else ["remote"])]
