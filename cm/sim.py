# SPDX-License-Identifier: Apache-2.0
"""The simulated board: `cm.simulation.software` under its name until 0.1, for one release."""

from __future__ import annotations

from cm.simulation.software import Board, BoardSpec, Control, Model, SimError

__all__ = ["Board", "BoardSpec", "Control", "Model", "SimError"]
