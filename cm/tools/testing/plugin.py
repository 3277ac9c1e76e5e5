# SPDX-License-Identifier: Apache-2.0
"""The fixtures ``board``, ``rtl_board`` and ``inject``, and the settings that say what they serve."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from cm.client.board import Board

_KEY: pytest.StashKey[Any] = pytest.StashKey()  # dict: managers that run, by what they serve


def pytest_addoption(parser: pytest.Parser, pluginmanager: pytest.PytestPluginManager) -> None:
    """Settings of pytest.ini or pyproject.toml."""
    _spare_rewriting(pluginmanager)
    text: Any = "string"  # pytest 9 takes types too, which type checkers look for in such words
    paths: Any = "paths"
    parser.addini("cm_config", "runtime schemas, or folders of them, for `board`", type=paths, default=[])
    parser.addini(
        "cm_build", "build schema whose RTL `rtl_board` runs (default: the shipped camera)", type=text, default=""
    )
    what = "CONFIG[/MODE] that each test begins in (default: the only configuration)"
    parser.addini("cm_load", what, type=text, default="")


def _spare_rewriting(pluginmanager: pytest.PytestPluginManager) -> None:
    """Leave the byte code of `cm` as it is: pytest takes the package of a plugin for test code, and would compile each
    of its modules anew, with other asserts, in each process of a first run. There is no public way to say so."""
    hook = pluginmanager.rewrite_hook
    marked: set[str] = getattr(hook, "_must_rewrite", set())
    marked.discard("cm")


def pytest_configure(config: pytest.Config) -> None:
    """The boards of this session."""
    config.stash[_KEY] = {}


def pytest_sessionfinish(session: pytest.Session) -> None:
    """End them."""
    for served in session.config.stash.get(_KEY, {}).values():
        served.stop()


@pytest.fixture
def board(request: pytest.FixtureRequest) -> Iterator[Board]:
    """A connected `cm.Board` on a simulated board of the schemas of `cm_config`, or else of the shipped camera.

    The manager runs as long as the session. Each test begins with the hardware as after power-up, without faults, and
    with `cm_load` loaded.
    """
    configs = tuple(map(str, request.config.getini("cm_config")))
    yield from _ready(request, "models", configs, "")


@pytest.fixture
def rtl_board(request: pytest.FixtureRequest) -> Iterator[Board]:
    """As `board`, with the RTL of the build schema of `cm_build` behind the nodes; skipped without Verilator."""
    from cm.simulation.rtl.errors import ToolMissing
    from cm.simulation.rtl.main import example_build, prepare

    given = str(request.config.getini("cm_build"))
    build = str(request.config.rootpath / given) if given else str(example_build())
    try:
        prepare(Path(build))
    except ToolMissing as missing:
        pytest.skip(f"the RTL {missing}")
    yield from _ready(request, "rtl", (), build)


@pytest.fixture
def inject(request: pytest.FixtureRequest) -> Iterator[Callable[..., None]]:
    """``inject(fault, target=None, count=1, value=0)`` on the board of the test; see `cm sim inject`.

    Faults that have not taken effect by the end of the test are forgotten.
    """
    name = next((name for name in ("rtl_board", "board") if name in request.fixturenames), "board")
    request.getfixturevalue(name)
    served = request.config.stash[_KEY]["now"]
    yield served.control.inject
    served.control.clear()


def _ready(request: pytest.FixtureRequest, kind: str, configs: tuple[str, ...], build: str) -> Iterator[Board]:
    from cm.client.board import connect
    from cm.tools.testing.served import Served

    boards = request.config.stash[_KEY]
    key = (kind, configs, build)
    if key not in boards or not boards[key].alive:
        boards[key] = Served(kind, configs, build)
    served = boards["now"] = boards[key]
    served.begin(str(request.config.getini("cm_load")))
    with pytest.MonkeyPatch.context() as patch, connect(str(served.runtime), timeout=60.0) as connected:
        for name in ("CM_CONNECT", "CM_KEYS", "CM_LEASE"):
            patch.delenv(name, raising=False)
        patch.setenv("CM_RUNTIME_DIR", str(served.runtime))  # an application that connects by itself finds this one
        yield connected
