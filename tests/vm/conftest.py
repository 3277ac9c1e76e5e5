# SPDX-License-Identifier: Apache-2.0
"""The cases run on the board, and those of the host need one."""

import os

collect_ignore = ["cases", "guest"]
collect_ignore += [] if "CM_VM_ENDPOINT" in os.environ else ["remote"]
collect_ignore += [] if "CM_VM_PLACE" in os.environ else ["service"]
