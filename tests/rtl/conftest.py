# SPDX-License-Identifier: Apache-2.0
"""RTL tests: skipped where a simulator is missing, and they say which."""

from __future__ import annotations

import contextlib
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    import cm

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent / "unit")]
sys.path.append(str(HERE.parent))


def needs(program: str) -> pytest.MarkDecorator:
    """Skip where a program is not installed."""
    return pytest.mark.skipif(shutil.which(program) is None, reason=f"needs {program}, which is not installed")


@contextlib.contextmanager
def served(folder: Path, build: Path, config: str, *options: str, **loading: Any) -> Iterator[cm.Board]:
    """A client of `cm serve --sim=rtl` with a design, of which a configuration was loaded."""
    from manager_process import Manager

    from cm.simulation.rtl.main import prepare

    prepare(build)  # a manager that waits for a compiler looks as if it hung
    manager = Manager(folder, "--sim=rtl", "--build", str(build), *options).start()
    try:
        with manager.connected() as connected:
            connected.load(config, **loading)
            yield connected
    finally:
        manager.stop()
