# SPDX-License-Identifier: Apache-2.0
"""``import pynq`` as this package, where PYNQ is not installed."""

from __future__ import annotations

import sys
from importlib import import_module
from importlib.abc import MetaPathFinder
from importlib.machinery import PathFinder
from typing import Any

_MODULES = ("", "board", "buffer", "interrupt", "lib", "lib.axigpio", "lib.dma", "mmio", "overlay", "registers")
_AS = {"board": ["board", "ps"], "buffer": ["buffer", "xlnk"], "overlay": ["overlay", "pl"]}  # modules of PYNQ's


class _Missing(MetaPathFinder):
    """Says of what is not here that it is not."""

    def find_spec(self, fullname: str, *_: Any) -> None:
        if fullname.partition(".")[0] == "pynq":
            raise ModuleNotFoundError(
                f"{fullname} is not here: cm.pynq has overlays, registers, buffers, DMA, AXI GPIO and interrupts, and "
                "neither video, audio, boards' peripherals nor MicroBlaze (docs/pynq.md)",
                name=fullname,
            )


def install() -> None:
    """From now on ``import pynq`` gives `cm.pynq`; twice is fine. Raises ImportError where PYNQ itself is installed."""
    if any(isinstance(finder, _Missing) for finder in sys.meta_path):
        return
    theirs = PathFinder.find_spec("pynq")
    if theirs is not None and theirs.origin:  # a mere folder of that name has none
        raise ImportError(
            f"PYNQ itself is installed here ({theirs.origin}), and is not shadowed: without cm.pynq the program runs "
            "on it; `import cm.pynq as pynq` in the program takes ours"
        )
    for name in _MODULES:
        for theirs_name in _AS.get(name, [name]):
            sys.modules[f"pynq.{theirs_name}".rstrip(".")] = import_module(f"cm.pynq.{name}".rstrip("."))
    sys.meta_path.insert(0, _Missing())
