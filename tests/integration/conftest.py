# SPDX-License-Identifier: Apache-2.0
"""A manager on a simulated board, as processes of their own: what users run."""

from __future__ import annotations

import os
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import zmq
from manager_process import REPOSITORY, Manager, served, short_folder

import cm
from cm.simulation.software import Board as SimBoard

_BUILD = "import sys; sys.path.insert(0, 'release'); import backend; print(backend.build_wheel(sys.argv[1]))"


@pytest.fixture
def runtime() -> Iterator[Path]:
    """A folder for the test's own manager."""
    with short_folder() as folder:
        yield folder


@pytest.fixture(scope="session")
def shared() -> Iterator[tuple[Manager, SimBoard]]:
    """One manager for all tests that do not kill it."""
    with served() as both:
        yield both


@pytest.fixture(scope="module")
def own() -> Iterator[tuple[Manager, SimBoard]]:
    """A manager for a module's tests that kill it or its board, and start again what they have killed."""
    with served() as both:
        yield both


@pytest.fixture
def manager(shared: tuple[Manager, SimBoard]) -> Manager:
    """The shared manager."""
    return shared[0]


@pytest.fixture
def board(manager: Manager) -> Iterator[cm.Board]:
    """A client of the shared manager: the camera example in its default mode, freshly loaded, no stream open."""
    with manager.connected() as connected:
        connected.load("camera", "default", force=True)
        for stream in connected.status.streams:
            if stream.open:
                connected.configure_stream(stream.name, automatic=True, force=True)
        yield connected


class KeptContext(zmq.Context[Any]):
    """Keeps its sockets, so that a failed test leaves none unclosed."""

    def __init__(self) -> None:
        super().__init__()
        object.__setattr__(self, "made", [])  # other attributes would be options of the context

    def socket(self, *arguments: Any, **options: Any) -> Any:
        self.made.append(super().socket(*arguments, **options))
        return self.made[-1]


@pytest.fixture
def context() -> Iterator[zmq.Context[Any]]:
    """A ZeroMQ context whose sockets end with the test."""
    made = KeptContext()
    yield made
    made.destroy(linger=0)


@pytest.fixture(scope="session")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the package as pip leaves it there, of the wheel for any system."""
    if not (REPOSITORY / ".git").exists():
        pytest.skip("needs a git checkout: builds what is in version control")
    folder = tmp_path_factory.mktemp("any")
    names = subprocess.run(["git", "ls-files", "-z"], cwd=REPOSITORY, capture_output=True, check=True).stdout
    tree = folder / "tree"
    tree.mkdir()
    subprocess.run(["xargs", "-0", "cp", "-P", "--parents", "-t", tree], input=names, cwd=REPOSITORY, check=True)
    env = {**os.environ, "CM_PURE": "1", "PYTHONWARNINGS": "ignore"}
    done = subprocess.run(
        [sys.executable, "-c", _BUILD, str(folder)], cwd=tree, env=env, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    wheel = folder / done.stdout.splitlines()[-1]
    assert wheel.stem.endswith("-py3-none-any")
    with zipfile.ZipFile(wheel) as archive:
        assert not [name for name in archive.namelist() if name.endswith(".so")]
        archive.extractall(folder / "installed")
    return folder / "installed"
