# SPDX-License-Identifier: Apache-2.0
"""Arrays in files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from cm.errors import InvalidRequest
from cm.wire.lazy_numpy import np

if TYPE_CHECKING:
    import numpy.typing as npt


def array_of(path: Path) -> npt.NDArray[Any]:
    """The array of a .npy file. Raises InvalidRequest."""
    try:
        with path.open("rb") as file:
            array: npt.NDArray[Any] = np.lib.format.read_array(file, allow_pickle=False)
            return array
    except OSError as error:
        raise InvalidRequest(f"{path} cannot be read: {error.strerror or error}") from error
    except (ValueError, MemoryError) as error:
        raise InvalidRequest(f"{path} cannot be read as .npy: {error}") from error
