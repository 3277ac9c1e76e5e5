# SPDX-License-Identifier: Apache-2.0
"""What boards answer and publish: read by a client of the fleet, or InvalidRequest; what was read can be shown."""

from __future__ import annotations

from contextlib import suppress

from cm.errors import CmError
from cm.networks.fleet.standing import difference
from cm.web.fleet import row
from cm.wire import cm_pb2 as pb
from cm.wire import fleet as wire
from cm.wire.fleet_records import decode_record, decode_step, encode_record
from cm.wire.messages.fleet import ClockSync, Decision, FleetRecord
from cm.wire.messages.status import ErrorInfo

PACKAGES = ("cm.wire", "cm.networks.fleet", "cm.web.fleet")
MAX_LENGTH = 2048


def seeds() -> list[bytes]:
    error = ErrorInfo("busy", "another change")
    record = FleetRecord("c1", "failed", "camera", "edge", "camera", "default", ("b1",), Decision.KEEP, error)
    status = pb.Status(config_name="camera", mode="default", sequence=7).SerializeToString()
    return [
        encode_record(record),
        wire.encode_answer(record),
        wire.encode_answer(error),
        status + wire.extras(("north",), ClockSync("chrony", True, 1500, "192.0.2.1", 10**18), record),
        pb.RegValues(values=[pb.RegValue(name="led", value=3)]).SerializeToString(),
        pb.Irq(name="done", count=1).SerializeToString(),
    ]


def one(data: bytes) -> None:
    with suppress(CmError):
        status = wire.board_status(data)
        difference(status)
        row("b1", status)
    with suppress(CmError):
        record = decode_record(data)
        assert repr(decode_record(encode_record(record))) == repr(record)  # a time may be no number, which equals none
    with suppress(CmError):
        answer = wire.decode_answer(data)
        assert wire.decode_answer(wire.encode_answer(answer)) is not None
    for read in (wire.body, wire.each_register, wire.irq_name, wire.stream_names, wire.decode_fetch, decode_step):
        with suppress(CmError):
            read(data)
