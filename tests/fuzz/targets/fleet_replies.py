# SPDX-License-Identifier: Apache-2.0
"""What boards answer and publish: read by a client of the fleet, or InvalidRequest; what was read can be shown."""

from __future__ import annotations

from contextlib import suppress

from cm.errors import CmError
from cm.networks.fleet.status_text import note, stands_apart
from cm.networks.fleet.store import Entry, views
from cm.web.fleet import row
from cm.wire import cm_pb2 as pb
from cm.wire import fleet as wire
from cm.wire.messages.fleet import FleetState
from cm.wire.messages.status import ErrorInfo, RegValues

PACKAGES = ("cm.wire", "cm.networks.fleet", "cm.web.fleet")
MAX_LENGTH = 2048


def seeds() -> list[bytes]:
    error = ErrorInfo("busy", "another change")
    record = FleetState("failed", 3, 4, "camera", "edge", "anna", error=error)
    status = pb.Status(config_name="camera", mode="default", sequence=7).SerializeToString()
    return [
        b'{"generation":3,"config":"camera","mode":"edge","by":"anna","change":"c1"}',
        wire.encode_answer(record),
        wire.encode_answer(error),
        status + wire.extras(("north",), record),
        pb.RegValues(values=[pb.RegValue(name="led", value=3)]).SerializeToString(),
        pb.Irq(name="done", count=1).SerializeToString(),
    ]


def one(data: bytes) -> None:
    with suppress(CmError):
        status = wire.board_status(data)
        stands_apart(status)
        note("b1", status)
        row("b1", status)
    text = data.decode("utf-8", "replace")
    for part in ("settings", "wanted", "claim"):
        with suppress(CmError):
            views({f"boards/b1/{part}": Entry(text, 1)})
    with suppress(CmError):
        answer = wire.decode_answer(data)
        assert isinstance(answer, RegValues) or wire.decode_answer(wire.encode_answer(answer)) is not None
    for read in (wire.body, wire.each_register, wire.glance, wire.decode_fetch, wire.decode_step):
        with suppress(CmError):
            read(data)
