# SPDX-License-Identifier: Apache-2.0
"""Messages as what JSON knows."""

from __future__ import annotations

from dataclasses import asdict
from enum import Enum
from typing import Any


def plain(message: Any) -> Any:
    """A frozen message as plain data, with the values of its enumerations."""
    return asdict(message, dict_factory=lambda pairs: {k: _known(v) for k, v in pairs})


def _known(value: Any) -> Any:
    if isinstance(value, tuple) and value and hasattr(value[0], "_asdict"):
        return [part._asdict() for part in value]
    return value.value if isinstance(value, Enum) else value
