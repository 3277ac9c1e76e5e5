# SPDX-License-Identifier: Apache-2.0
"""``import pynq`` as this package, where PYNQ is not installed; a sentence for what is not here."""

from __future__ import annotations

import sys
from importlib import import_module
from importlib.abc import MetaPathFinder
from importlib.machinery import PathFinder
from typing import NoReturn

_MODULES = ("", "lib", "lib.axigpio", "lib.dma", "mmio", "overlay")
_IN = {"buffer": "board", "interrupt": "board", "pl": "overlay", "ps": "board", "registers": "mmio", "xlnk": "board"}
_ELSEWHERE = {
    "pynq.GPIO": "the processor's own GPIO is the kernel's (libgpiod); decouplers on it are the manager's",
    "pynq.Device": "a program has one board, that of $CM_CONNECT or of this machine",
    "pynq.lib.AxiIIC": "an AXI IIC is the kernel's (i2c-xiic): /dev/i2c-N, for the users who may open it",
}


def absent(module: str, name: str) -> NoReturn:
    """Say that a class is not here: raises ImportError with a sentence, AttributeError for what is no class."""
    if not name[:1].isupper():  # submodules are looked for by import
        raise AttributeError(f"module {module!r} has no attribute {name!r}")
    raise ImportError(_sentence(f"{module}.{name}"))


def _sentence(name: str) -> str:
    usual = "cm.pynq has overlays, registers, buffers, interrupts, DMA and AXI GPIO, and no other driver (docs/pynq.md)"
    return f"{name} is not here: {_ELSEWHERE.get(name, usual)}"


class _Missing(MetaPathFinder):
    """Says of what is not here that it is not."""

    def find_spec(self, fullname: str, *_: object) -> None:
        if fullname.partition(".")[0] == "pynq":
            raise ModuleNotFoundError(_sentence(fullname), name=fullname)


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
    for name in (*_MODULES, *_IN):
        sys.modules[f"pynq.{name}".rstrip(".")] = import_module(f"cm.pynq.{_IN.get(name, name)}".rstrip("."))
    sys.meta_path.insert(0, _Missing())
