# SPDX-License-Identifier: Apache-2.0
"""An extension of IPython that completes names in calls: ``board.stream("<TAB>``, ``board.mode = "<TAB>``.

`cm.connect` loads it where IPython runs.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from cm.client.board import Board
from cm.client.core import calls
from cm.errors import CmError

_PATIENCE = 1.0  # seconds that Tab may take
_NAME = r"[A-Za-z_]\w*"
_TYPED = re.compile(
    rf"""(?:.*[^\w.])?(?P<board>{_NAME})\.(?P<call>{_NAME})   # an object, and what is called or set of it
    (?:\s*=|\(|\((?P<first>[^()]*),\s*(?:mode\s*=)?)\s*["'][^"']*$  # up to the text that is completed""",
    re.VERBOSE,
)


def _modes(board: Board, config: str = "") -> Iterable[str]:
    return [mode.name for mode in board.ask(calls.describe(config), timeout=_PATIENCE).modes]


def _configs(board: Board) -> Iterable[str]:
    return board.ask(calls.config_names(), timeout=_PATIENCE)


def _regions(board: Board) -> Iterable[str]:
    return [region.name for region in board.ask(calls.status(), timeout=_PATIENCE).regions]


def _streams(board: Board) -> Iterable[str]:
    return [stream.name for stream in board.ask(calls.status(), timeout=_PATIENCE).streams]


_NAMES: Mapping[str, Callable[[Board], Iterable[str]]] = {
    **dict.fromkeys(("mode", "set_mode", "plan"), _modes),
    **dict.fromkeys(("load", "load_async", "config", "remove_config"), _configs),
    **dict.fromkeys(("unload", "check_region", "map_region"), _regions),
    **dict.fromkeys(("stream", "read", "write", "writer", "configure_stream"), _streams),
}


def _completed(shell: Any, event: Any) -> list[str]:
    """What may stand in the text that was begun; nothing where no board is asked, or it does not answer."""
    typed = _TYPED.match(event.text_until_cursor)
    board = shell.user_ns.get(typed["board"]) if typed else None
    if typed is None or not isinstance(board, Board) or typed["call"] not in _NAMES:
        return []
    try:
        if typed["first"] is None:
            return list(_NAMES[typed["call"]](board))
        loads = typed["call"] in ("load", "load_async")
        return list(_modes(board, typed["first"].strip("\"' "))) if loads else []
    except CmError:
        return []


def load_ipython_extension(shell: Any) -> None:
    """IPython calls it, once in a session."""
    shell.set_hook("complete_command", _completed, re_key=_TYPED)
