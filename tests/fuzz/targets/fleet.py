# SPDX-License-Identifier: Apache-2.0
"""Queries that reach a board's bridge: each is answered, with what its manager says or with a Reply that refuses it.

An input is a key, the selector's parameters, a payload and what travels beside it.
"""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any

import zenoh
from pieces import join, split

from cm.errors import CmError
from cm.networks.fleet import keys
from cm.networks.fleet.bridge.query_answers import Queries
from cm.networks.fleet.reconciling_board import Board, Notes, Part, Place, Planned, Seen
from cm.networks.fleet.store import Claim, Entry, Wanted, packed
from cm.wire import cm_pb2 as pb
from cm.wire.encode import encoded
from cm.wire.fleet import encode_answer
from cm.wire.messages.fleet import FetchBundle, FleetStep
from cm.wire.messages.status import ErrorInfo

PACKAGES = ("cm.networks.fleet", "cm.wire")
MAX_LENGTH = 4096

_REFUSED = encode_answer(ErrorInfo("unknown", "the manager of this fuzzer knows nothing"))


class _Disk:
    def __init__(self) -> None:
        self.notes = Notes()

    def read(self) -> Notes:
        return self.notes

    def write(self, notes: Notes) -> None:
        self.notes = notes


class _Manager:
    """What the bridge has of its manager and its fleet: everything works, and nothing is known."""

    @property
    def relay(self) -> _Manager:
        return self

    def guest(self, caller: str) -> str:
        return f"zenoh:{caller}"

    async def forward(self, frames: list[bytes], guest: str = "", timeout: float = 0.0) -> list[bytes]:
        assert all(isinstance(frame, bytes) for frame in frames)
        return [b"", _REFUSED]

    async def ask(self, asked: Any, guest: str = "", timeout: float | None = None) -> Any:
        raise CmError("nothing is known")

    async def get(self, prefix: str) -> dict[str, Entry]:
        wanted, claim = Wanted(3, "camera", "default", "bob", "c0"), Claim(4, "c1", "anna")
        return {f"{prefix}wanted": Entry(packed(wanted), 5), f"{prefix}claim": Entry(packed(claim), 6)}

    async def where(self, known: Seen | None = None) -> Seen:
        return Seen(("camera", "default"), 1)

    async def plan(self, step: FleetStep, caller: str) -> Planned:
        return Planned((step.config_name, step.mode), 0.1, 1)

    async def hold(self, part: Part) -> None: ...

    async def release(self, part: Part) -> None: ...

    async def load(self, place: Place, caller: str, undoable: str = "") -> float:
        return 0.1

    async def undo(self, part: Part) -> None: ...


class _Query:
    """As zenoh hands one out."""

    def __init__(self, key: Any, parameters: Any, payload: bytes | None, attachment: bytes | None) -> None:
        self.key_expr, self.parameters = key, parameters
        self.payload, self.attachment = payload, attachment
        self.answers: list[tuple[bytes, str]] = []

    def __enter__(self) -> None: ...

    def __exit__(self, *_: object) -> None: ...

    def reply(self, key: str, payload: bytes, encoding: str = "", attachment: bytes | None = None) -> None:
        assert self.key_expr.intersects(zenoh.KeyExpr(key)), (str(self.key_expr), key)
        self.answers.append((attachment or payload, encoding))

    def reply_err(self, payload: bytes, encoding: str = "") -> None:
        self.answers.append((payload, encoding))


def seeds() -> list[bytes]:
    step = encoded(FleetStep("c1", "camera", "edge", 4))
    fetch = encoded(FetchBundle("0" * 64, 5, "a.tar.gz"))
    verbs = ("prepare", "apply", "reconcile")
    found = [[f"cm/b1/do/{verb}/anna".encode(), b"", step, b""] for verb in verbs]
    found += [
        [b"cm/b1/do/bundle/anna", b"", fetch, b""],
        [b"cm/b1/do/data/anna", b"", b"1234", pb.WriteData(stream="camera").SerializeToString()],
        [b"cm/*/reg/led", b"", b"", b""],
        [b"cm/b1/config", b"plan=edge;config=camera", b"", b""],
        [b"cm/b1/frames/camera", b"", b"", b""],
    ]
    return [join(each) for each in found]


def one(data: bytes) -> None:
    pieces = [*split(data), b"", b"", b"", b""]
    try:
        key = zenoh.KeyExpr(pieces[0].decode())
        parameters = zenoh.Parameters(pieces[1].decode())
    except (UnicodeDecodeError, zenoh.ZError):
        return  # nothing that the network would have carried
    if not key.intersects(zenoh.KeyExpr("cm/b1/**")):
        return
    query = _Query(key, parameters, pieces[2] or None, pieces[3] or None)
    asyncio.run(_answered(query))
    for payload, encoding in query.answers:
        if encoding.endswith("cm.Reply"):
            pb.Reply.FromString(payload)


async def _answered(query: _Query) -> None:
    manager: Any = _Manager()
    board = Board("b1", manager, manager, _Disk(), lambda: 0.0)
    session: Any = SimpleNamespace(declare_queryable=lambda *_, **__: None)

    async def status() -> bytes:
        return pb.Status(config_name="camera", mode="default").SerializeToString()

    await Queries("b1", session, board, manager, status, _no_bundle).answer(query)
    assert query.answers or keys.WILD & set(str(query.key_expr)), "nobody was told anything"
    await board.look()  # whatever was written down can be gone on from


async def _no_bundle(bundle: FetchBundle, caller: str) -> Any:
    raise CmError("this board takes no archives")
