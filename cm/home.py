# SPDX-License-Identifier: Apache-2.0
"""Folders of this user, as the XDG base directory specification has them, also for a user who has no home."""

from __future__ import annotations

import os
from pathlib import Path


def cache_home() -> Path:
    """``$XDG_CACHE_HOME``, by default ``~/.cache``."""
    return Path(os.environ.get("XDG_CACHE_HOME") or _home() / ".cache")


def state_home() -> Path:
    """``$XDG_STATE_HOME``, by default ``~/.local/state``."""
    return Path(os.environ.get("XDG_STATE_HOME") or _home() / ".local" / "state")


def _home() -> Path:
    """/ for a number without an account and $HOME, as in a container: it is the system that refuses to write there."""
    try:
        return Path.home()
    except RuntimeError:
        return Path("/")
