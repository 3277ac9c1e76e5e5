# SPDX-License-Identifier: Apache-2.0
"""numpy, imported when it is first used: what needs no arrays is there sooner for it."""

from __future__ import annotations

from typing import Any


class _Later:
    """Stands for the module; what was used once is kept as an attribute of its own."""

    def __getattr__(self, name: str) -> Any:
        import numpy

        value = getattr(numpy, name)
        setattr(self, name, value)
        return value


np = _Later()
