# SPDX-License-Identifier: Apache-2.0
"""`cm web` over TCP with its own key: its pages can do no more than that key, whatever `--control` says."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from typing import Any

import pytest
from manager_process import CAMERA, short_folder, until
from test_rights_tcp import Guarded
from test_web_server import page
from web_support import WebServer, web_server

from cm.simulation.software import Board as SimBoard

pytestmark = pytest.mark.web


@pytest.fixture(scope="module")
def guarded() -> Iterator[Guarded]:
    with short_folder() as folder, SimBoard([CAMERA], root=folder / "board") as sim:
        made = Guarded(folder, sim.root)
        for name, role in (("looker", "observe"), ("driver", "operate")):
            made.key(name, role)
        made.reload()
        for name in ("looker", "driver"):
            until(lambda name=name: made.lets_in(name), 60)  # the daemon rereads it when it gets round to it
        yield made
        made.manager.stop()


def served_as(guarded: Guarded, name: str) -> Any:
    return web_server(None, "--control", "--connect", guarded.address, "--keys", str(guarded.keys / f"{name}.key"))


async def tried(server: WebServer, what: str, **words: Any) -> str:
    """The code of the refusal; empty if it was done."""
    async with page(server) as made:
        reply = await made.ask(1, what, **words)
        return str(reply.get("error", {}).get("code", ""))


def test_a_server_that_may_only_observe_shows_frames_and_changes_nothing(guarded: Guarded) -> None:
    async def looked(server: WebServer) -> None:
        async with page(server) as made:
            await made.socket.send_json({"watch": {"camera": ""}})
            await made.until(lambda: made.pictures >= 3)
            assert made.topics["status"]["mode"] == "default"
            assert made.topics["config"]["registers"]

    with served_as(guarded, "looker") as server:
        asyncio.run(looked(server))
        assert asyncio.run(tried(server, "mode", mode="colorise")) == "forbidden"
        assert asyncio.run(tried(server, "write", name="focus", value=2)) == "forbidden"
        assert asyncio.run(tried(server, "plan", mode="colorise")) == ""


def test_one_that_may_operate_changes_the_mode(guarded: Guarded) -> None:
    with served_as(guarded, "driver") as server:
        assert asyncio.run(tried(server, "mode", mode="colorise")) == ""
        assert asyncio.run(tried(server, "write", name="palette", value=2)) == ""
    with guarded.connect("owner") as board:
        assert (board.mode, board.registers["palette"]) == ("colorise", 2)
