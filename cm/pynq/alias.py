# SPDX-License-Identifier: Apache-2.0
"""``import pynq`` as this package, where PYNQ is not installed."""

from __future__ import annotations

import importlib
import sys
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import find_spec
from types import ModuleType
from typing import Any

_OURS = "cm.pynq"


class _SameModule(Loader):
    """Gives the module of this package, once, under both names."""

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        module = importlib.import_module(_ours(spec.name))
        self._spec = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        module.__spec__ = self._spec  # the import has set that of the other name


class _Finder(MetaPathFinder):
    def find_spec(self, fullname: str, *_: Any) -> ModuleSpec | None:
        if fullname != "pynq" and not fullname.startswith("pynq."):
            return None
        found = find_spec(_ours(fullname))
        if found is None:
            raise ModuleNotFoundError(
                f"{fullname} is not here: cm.pynq has overlays, registers, buffers, DMA, AXI GPIO and interrupts, and "
                "neither video, audio, boards' peripherals nor MicroBlaze (docs/pynq.md)",
                name=fullname,
            )
        return ModuleSpec(fullname, _SameModule(), is_package=found.submodule_search_locations is not None)


def _ours(name: str) -> str:
    return _OURS + name.removeprefix("pynq")


def install() -> None:
    """From now on ``import pynq`` gives `cm.pynq`; twice is fine. Raises ImportError where PYNQ itself is installed."""
    if any(isinstance(finder, _Finder) for finder in sys.meta_path):
        return
    theirs = PathFinder.find_spec("pynq")
    if theirs is not None and theirs.origin:  # a mere folder of that name has none
        raise ImportError(
            f"PYNQ itself is installed here ({theirs.origin}), and is not shadowed: without cm.pynq the program runs "
            "on it; `import cm.pynq as pynq` in the program takes ours"
        )
    sys.meta_path.insert(0, _Finder())
