# SPDX-License-Identifier: Apache-2.0
"""This user: folders, as the XDG base directory specification has them, and name; also for who has neither.

A number without an account and $HOME, as in a container.
"""

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
    """/ where there is none: it is the system that refuses to write there."""
    try:
        return Path.home()
    except RuntimeError:
        return Path("/")


def account(otherwise: str) -> str:
    """The name of this user's account, or what is given."""
    import getpass  # here: starting the manager does without

    try:
        return getpass.getuser()
    except (ImportError, KeyError, OSError):
        return otherwise
