# SPDX-License-Identifier: Apache-2.0
"""A region's common boundary: the union of its modules' interfaces, and how each module is fitted to it.

boundary(modules) -> Boundary
"""

from __future__ import annotations

from cm.design.boundary.make import boundary
from cm.design.boundary.model import Adaptation, Boundary, BoundaryPort, Connection, Fit, Role

__all__ = ["Adaptation", "Boundary", "BoundaryPort", "Connection", "Fit", "Role", "boundary"]
