# SPDX-License-Identifier: Apache-2.0
"""What is too long for one message is uploaded in parts; and what becomes of parts that nobody uses."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zmq
from manager_process import Manager, served

from cm.client.core import uploads
from cm.client.errors import RequestFailed
from cm.wire.encode import decode_reply, encode_request
from cm.wire.messages import requests as rq
from cm.wire.messages.status import Reply, UploadInfo

MIB = 1 << 20
SCHEMA = """
config:
  name: sent
  regions: [left]
  modules: {fir: {region: left}}
  mmio: [{base_address: 0x1000, registers: {led: {offset: 0x10}}}]
  modes: {default: {modules: [fir]}}
"""


@pytest.fixture(scope="module")
def manager() -> Iterator[Manager]:
    with served(arguments=("--stream-queue", "32")) as (made, _):
        with made.connected() as board:
            board.load("camera", "default")
        yield made


def ask(context: zmq.Context[Any], manager: Manager, *requests: rq.Request) -> list[Reply]:
    socket = context.socket(zmq.REQ)
    socket.connect(f"ipc://{manager.runtime}/req")
    replies = []
    for request in requests:
        socket.send_multipart(encode_request(request))
        assert socket.poll(60_000)
        replies.append(decode_reply(socket.recv_multipart()))
    return replies


def code(reply: Reply) -> str:
    return reply.error.code if reply.error else ""


def test_files_longer_than_a_message_are_provisioned_whole(manager: Manager, tmp_path: Path) -> None:
    schema, image = tmp_path / "sent.yaml", tmp_path / "fir.bin"
    schema.write_text(SCHEMA, encoding="utf-8")
    data = np.random.default_rng(1).integers(0, 256, 20 * MIB, np.uint8).tobytes()
    image.write_bytes(data)
    with manager.connected() as board:
        assert board.provision(schema, image, tmp_path / "sent.yaml").name == "sent"
        assert all(client.upload_bytes == 0 for client in board.clients())
    (stored,) = manager.runtime.parent.glob("state/configs/sent/fir.bin")
    assert hashlib.sha256(stored.read_bytes()).digest() == hashlib.sha256(data).digest()


def test_a_frame_longer_than_a_message_is_written(manager: Manager) -> None:
    frame = np.arange(10 * MIB, dtype=np.uint8)
    with manager.connected() as board:
        with pytest.raises(RequestFailed, match=f"{10 * MIB}"):  # it came whole: the stream's frames are shorter
            board.write("to_pl", frame)
        assert all(client.upload_bytes == 0 for client in board.clients())


def test_parts_come_in_their_order(manager: Manager, context: zmq.Context[Any]) -> None:
    data = bytes(range(256)) * 16
    first, second = rq.Upload("a", 4096, 0, data[:1000]), rq.Upload("a", 4096, 1000, data[1000:])
    replies = ask(context, manager, first, rq.Upload("a", 4096, 500, b"x"), second, rq.Upload("a", 0, discard=True))
    assert [reply.body for reply in replies[:3]] == [UploadInfo("a", 4096, 1000), None, UploadInfo("a", 4096, 4096)]
    assert code(replies[1]) == "invalid_request"


def test_an_upload_is_used_up_by_the_request_that_is_accepted(manager: Manager, context: zmq.Context[Any]) -> None:
    def sent(schema: str) -> rq.Provision:
        return rq.Provision(schema, (rq.File("fir.bin", b"", hashlib.sha256(data).hexdigest(), "p"),))

    data = bytes(range(256)) * 16
    upload = rq.Upload("p", 4096, 0, data)
    good, wrong = sent(SCHEMA.replace("sent", "parts")), sent("config: [")
    replies = ask(context, manager, upload, wrong, good, good)
    assert [code(reply) for reply in replies] == ["", "schema_invalid", "", "unknown_upload"]


def test_incomplete_uploads_are_not_used(manager: Manager, context: zmq.Context[Any]) -> None:
    replies = ask(
        context, manager, rq.Upload("b", 4096, 0, bytes(10)), rq.WriteData("to_pl", upload="b"),
        rq.Upload("c", 4096, 5, bytes(10)), rq.Upload("d", 4, 0, bytes(10)), rq.Upload("d", 4, discard=True),
    )  # fmt: skip
    assert [code(reply) for reply in replies] == ["", "unknown_upload", "unknown_upload", "invalid_request", ""]


def test_uploads_beyond_the_limit_are_refused_and_others_go_on(manager: Manager, context: zmq.Context[Any]) -> None:
    big = rq.Upload("e", 200 * MIB, 0, bytes(10))
    replies = ask(context, manager, big, rq.Upload("f", 200 * MIB, 0, bytes(10)), rq.Upload("e", 0, discard=True))
    assert [code(reply) for reply in replies] == ["", "too_much_uploaded", ""]


def test_a_manager_without_uploads_gets_everything_in_one_message() -> None:
    flow = uploads.upload(bytes(10 * MIB))
    next(flow)
    from cm.client.errors import RequestInvalid
    from cm.wire.messages.status import ErrorInfo

    with pytest.raises(StopIteration) as ended:
        flow.throw(RequestInvalid(ErrorInfo("invalid_request", "unknown topic 'cm_upload'; topics are cm_status")))
    assert ended.value.value == ""
