# SPDX-License-Identifier: Apache-2.0
"""Arrays in files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from cm.errors import InvalidRequest


def array_of(path: Path) -> np.ndarray[Any, Any]:
    """The array of a .npy file. Raises InvalidRequest."""
    try:
        with path.open("rb") as file:
            return np.lib.format.read_array(file, allow_pickle=False)
    except OSError as error:
        raise InvalidRequest(f"{path} cannot be read: {error.strerror or error}") from error
    except (ValueError, MemoryError) as error:
        raise InvalidRequest(f"{path} cannot be read as .npy: {error}") from error
