# SPDX-License-Identifier: Apache-2.0
"""`Clocks`: the clocks that the processor gives the PL, for reading."""

from __future__ import annotations

import re
from typing import Any

from cm.pynq.board import board


class _Clocks(type):
    def __getattr__(cls, name: str) -> float:
        found = re.fullmatch(r"(?:fclk|pl)(\d)_mhz", name)
        if found is None:
            raise AttributeError(f"Clocks has no {name!r}: it has fclk0_mhz to fclk3_mhz")
        for clock in board().status.clocks:
            if re.fullmatch(rf"(?:fclk|pl){found[1]}", clock.name):
                return (clock.rate or clock.wanted) / 1e6
        raise AttributeError(f"the loaded configuration has no clock {found[1]}")

    def __setattr__(cls, name: str, value: Any) -> None:
        raise NotImplementedError(
            f"Clocks.{name} = {value}: a rate belongs to the configuration (`clocks:` of its schema), which sets it "
            "with each load"
        )


class Clocks(metaclass=_Clocks):
    """``Clocks.fclk0_mhz`` and so on, in MHz. Setting one raises NotImplementedError."""
