# SPDX-License-Identifier: Apache-2.0
"""Two folders that change places in one step."""

from __future__ import annotations

import os

from cm.device.native._cm import lib
from cm.device.native.call import check


def exchange(one: str, other: str) -> None:
    """Exchange what stands at two paths of one file system; OSError (EINVAL if the file system cannot do this)."""
    check(lib.cm_exchange(os.fsencode(one), os.fsencode(other)))
