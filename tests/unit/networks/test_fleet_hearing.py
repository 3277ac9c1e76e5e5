# SPDX-License-Identifier: Apache-2.0
"""A bridge hears itself through the network, and notices if it does not any more."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from pathlib import Path
from unittest.mock import MagicMock

import pytest

from cm.networks.fleet.bridge import bridge_process
from cm.networks.fleet.bridge.bridge_process import Bridge, Options
from cm.networks.fleet.zenoh_session import Network, NoNetwork, closed, hears, session
from cm.tools.demo.boards import free_ports


def listened(monkeypatch: pytest.MonkeyPatch, heard: Iterable[bool | None]) -> int:
    """How many questions to itself a bridge needs, of those with these answers, until it knows that it is deaf."""
    answers, asked = iter(heard), []

    def ask(_: Network, keys: Iterable[str], timeout: float) -> bool | None:
        asked.append((*keys, timeout))
        return next(answers)

    monkeypatch.setattr(bridge_process, "hears", ask)
    monkeypatch.setattr(bridge_process, "_HEAR", 0.0)
    monkeypatch.setattr(bridge_process, "_LISTEN", 0.0)
    monkeypatch.setattr(bridge_process, "_RECONNECT", 0.0)
    bridge = Bridge(Options(Network(), Path("/nowhere"), keeps=True), lambda _: None)
    bridge._board = MagicMock()
    with pytest.raises(NoNetwork, match="opened anew"):
        asyncio.run(bridge._hear("b1"))
    assert set(asked) == {("cm/b1/alive", "cm-store/get/b1", 5.0)}
    return len(asked)


@pytest.mark.parametrize(
    ("heard", "questions"),
    [
        ((True, False, False), 3),
        ((True, False, True, False, None, False, False), 7),  # one answer was lost, and no network says nothing of us
        ((False, False, False, None, True, False, False), 7),  # rules that do not let us hear ourselves: no reason
    ],
)
def test_it_is_deaf_if_nothing_comes_twice_where_something_did_before(
    monkeypatch: pytest.MonkeyPatch, heard: tuple[bool | None, ...], questions: int
) -> None:
    assert listened(monkeypatch, heard) == questions


def test_another_session_tells_whether_who_offers_a_key_answers() -> None:
    port = free_ports()
    network = Network(connect=(f"tcp/127.0.0.1:{port}",))
    assert hears(network, ["cm/b1/alive"], 5.0) is None
    router = session(Network(mode="router", listen=(f"tcp/127.0.0.1:{port}",)))
    try:
        assert hears(network, ["cm/b1/alive"], 5.0) is False
        board = session(network)
        offered = board.declare_queryable("cm/b1/**", lambda query: query.reply_err(b"nothing there"), complete=True)
        assert hears(network, ["cm/b1/alive"], 5.0) is True
        assert hears(network, ["cm/b1/alive", "cm-store/get/b1"], 5.0) is False  # one of two
        offered.undeclare()
        closed(board)
    finally:
        closed(router)
