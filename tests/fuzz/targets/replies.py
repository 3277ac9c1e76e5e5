# SPDX-License-Identifier: Apache-2.0
"""What a client gets from whatever answers at the address: replies and events, or InvalidRequest."""

from __future__ import annotations

from contextlib import suppress

from pieces import join, split

from cm.errors import InvalidRequest
from cm.wire import cm_pb2 as pb
from cm.wire import topics
from cm.wire.encode import decode_event, decode_reply, encode_irq, encode_registers, encode_reply, encode_status
from cm.wire.messages import status as st

PACKAGES = ("cm.wire",)
MAX_LENGTH = 4096


def seeds() -> list[bytes]:
    status = st.Status("camera", "edge", sequence=3, progress=st.Progress(1, "camera", "edge", "load"))
    values = st.RegValues((st.RegValue("focus", 2, (("low", 1),)),), "camera", "edge")
    replies = [
        encode_reply(topics.STATUS, st.Reply(body=status, sequence=1)),
        encode_reply(topics.READ_REG, st.Reply(body=values, sequence=2)),
        encode_reply(topics.READ_REG, st.Reply(error=st.ErrorInfo("busy", "a change runs"))),
        [topics.READ_CONFIG, pb.Reply(ok=True, config=pb.Config(name="camera")).SerializeToString()],
        [topics.READ_DATA, pb.Reply(ok=True, frame=pb.Frame(shape=[2, 2])).SerializeToString(), b"1234"],
    ]
    events = [encode_status(status), encode_registers(values), encode_irq(st.Irq("done", 1, 2))]
    events.append([b"cm_stream/camera", pb.Frame(stream="camera", length=4).SerializeToString(), b"1234"])
    return [join(map(bytes, frames)) for frames in (*replies, *events)]


def one(data: bytes) -> None:
    for decode in (decode_reply, decode_event):
        with suppress(InvalidRequest):
            decode(split(data))
