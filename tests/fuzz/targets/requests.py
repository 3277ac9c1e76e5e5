# SPDX-License-Identifier: Apache-2.0
"""Requests as they come from ZeroMQ: decoded, or refused with InvalidRequest.

The line of the log that tells of one is printable, and what is decoded keeps its meaning when it is encoded and
decoded once more.
"""

from __future__ import annotations

from contextlib import suppress

from pieces import join, split

from cm.errors import InvalidRequest
from cm.server.rights.audit import described
from cm.server.rights.principal import NOBODY
from cm.wire import cm_pb2 as pb
from cm.wire import topics
from cm.wire.decode import decode_request
from cm.wire.encode import encode_request
from cm.wire.messages import requests as rq

PACKAGES = ("cm.wire", "cm.server.rights")
MAX_LENGTH = 4096


def seeds() -> list[bytes]:
    files = pb.WriteConfig(schema="config: {}", files=[pb.File(name="a.bit", length=3)], mode="edge")
    return [
        *(join(encode_request(request)) for request in _requests()),
        join([topics.WRITE_CONFIG, files.SerializeToString(), b"abc"]),
        join([b"cm_config edge"]),
        join([topics.TEXT_CONFIG, b"camera/edge_detection"]),
        join([b"cm_write_reg { 'focus':0x2}"]),
    ]


def _requests() -> list[rq.Request]:
    return [
        rq.ReadStatus(),
        rq.ListConfigs(),
        rq.PlanChange("camera", "edge"),
        rq.ChangeMode("camera", "edge", force=True, lease="1"),
        rq.ChangeMode(unload="prr0"),
        rq.CancelChange(),
        rq.ReadReg(("focus", "zoom")),
        rq.WriteReg((rq.RegWrite("focus", 2, mask=3),), "1"),
        rq.ConfigureStream("camera", shape=(480, 640), dtype="uint8", slots=4, rate=30.0, cyclic=False),
        rq.DefineMemory("taps", 0x1000, length=64, shape=(4, 4), dtype="uint32", access="rw", region="prr0"),
        rq.ReadData("camera", 1.0),
        rq.WriteData("to_pl", b"\1\2\3"),
        rq.ReadIrq("frame_done"),
        rq.TakeLease("registers:focus", True, seconds=10.0, holder="me", pid=1),
    ]


def one(data: bytes) -> None:
    with suppress(InvalidRequest):
        request = decode_request(encode_request(decode_request(split(data))))  # with the hashes of files
        assert described(NOBODY, request).isprintable(), "a line of the log is made of what the request says"
        assert repr(decode_request(encode_request(request))) == repr(request)  # repr: NaN is not equal to itself
