# SPDX-License-Identifier: Apache-2.0
"""numpy, imported when it is first used, so that programs that need no arrays start sooner.

Checkers of types see numpy itself; `NDArray` is for annotations only.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

__all__ = ["NDArray", "np"]

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
else:

    class _Later:
        """Stands for the module; what has been used once is kept as an attribute."""

        def __getattr__(self, name: str) -> Any:
            import numpy

            value = getattr(numpy, name)
            setattr(self, name, value)
            return value

    np, NDArray = _Later(), Any
