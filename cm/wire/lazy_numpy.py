# SPDX-License-Identifier: Apache-2.0
"""numpy, imported when it is first used, so that programs that need no arrays start sooner."""

from __future__ import annotations

from typing import Any


class _Later:
    """Stands for the module; what has been used once is kept as an attribute."""

    def __getattr__(self, name: str) -> Any:
        import numpy

        value = getattr(numpy, name)
        setattr(self, name, value)
        return value


np = _Later()
