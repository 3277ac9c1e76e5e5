# SPDX-License-Identifier: Apache-2.0
"""A manager that answers wrongly, over ZMTP and on the data socket: what `test_wrong_answers.py` gives each client.

A case is a name of `CASES`; its folder has the sockets `req`, `pub` and `data` of a manager. Whatever it does not do
wrongly it does right.
"""

from __future__ import annotations

import itertools
import os
import socket
import struct
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from cm.wire import cm_pb2 as pb
from cm.wire import plane_packets as packets
from cm.wire.plane_packets import Descriptor, Geometry, WindowPages

MORE, LONG, COMMAND = 1, 2, 4
MIB, HUGE = 1 << 20, 1 << 62
VALUE = 7
GREETING = b"\xff" + bytes(8) + b"\x7f\x03\x01" + b"NULL" + bytes(48)


def _property(name: bytes, value: bytes) -> bytes:
    return bytes([len(name)]) + name + struct.pack(">I", len(value)) + value


def _framed(flags: int, body: bytes) -> bytes:
    return bytes([flags, len(body)]) + body if len(body) < 256 else _announced(flags, len(body)) + body


def _announced(flags: int, length: int) -> bytes:
    return bytes([flags | LONG]) + struct.pack(">Q", length)


def _message(parts: list[bytes]) -> bytes:
    return b"".join(_framed(MORE if at < len(parts) - 1 else 0, part) for at, part in enumerate(parts))


def _ready(kind: bytes) -> bytes:
    return _framed(COMMAND, b"\x05READY" + _property(b"Socket-Type", kind) + _property(b"Identity", b""))


STATUS = pb.Status(config_name="fake", mode="good").SerializeToString()

# ---- what is wrong before the first message; nothing more is sent then ----

CONNECTING: dict[str, bytes] = {
    "says nothing": b"",
    "half a greeting": GREETING[:30],
    "no ZMTP": b"HTTP/1.1 400 Bad\r\n" * 10,
    "no READY": GREETING,
    "an empty READY": GREETING + _framed(COMMAND, b""),
    "a READY whose name is longer than it": GREETING + _framed(COMMAND, b"\xffREADY"),
    "a READY of 2**62 bytes": GREETING + _announced(COMMAND, HUGE),
    "an ERROR without a reason": GREETING + _framed(COMMAND, b"\x05ERROR"),
}

# ---- a reply: number, topic and the right reply → bytes on the wire; b"" and "hang up" end the connection ----

Reply = Callable[[bytes, bytes, bytes], bytes]


def _right(number: bytes, topic: bytes, reply: bytes, *payload: bytes) -> bytes:
    return _message([number, b"", topic, reply, *payload])


REPLIES: dict[str, Reply] = {
    "none": lambda *_: b"",
    "cut off": lambda n, t, r: _right(n, t, r)[:7],
    "no protobuf": lambda n, t, _: _right(n, t, b"\xff" * 10),
    "cut short": lambda n, t, r: _right(n, t, r[:-3]),
    "nested without end": lambda n, t, _: _right(n, t, b"\x08\x01" + b"\x63" * 5000),
    "a length of 2 GiB inside": lambda n, t, _: _right(n, t, b"\x08\x01\x62\xff\xff\xff\xff\x07"),
    "without a body": lambda n, t, _: _right(n, t, pb.Reply(ok=True).SerializeToString()),
    "of another kind": lambda n, t, _: _right(n, t, pb.Reply(ok=True, irq=pb.Irq(name="i")).SerializeToString()),
    "a refusal without a reason": lambda n, t, _: _right(n, t, pb.Reply().SerializeToString()),
    "empty": lambda n, t, _: _right(n, t, b""),
    "without the empty frame": lambda n, t, r: _message([n, t, r]),
    "too few frames": lambda n, *_: _message([n, b""]),
    "the number alone": lambda n, *_: _message([n]),
    "empty frames": lambda *_: _message([b"", b"", b"", b""]),
    "another number": lambda _, t, r: _right(b"777777", t, r),
    "a long number": lambda _, t, r: _right(b"9" * 100_000, t, r),
    "twice": lambda n, t, r: _right(n, t, r) * 2,
    "many that nobody asked for": lambda n, t, r: _right(b"u", t, r) * 20_000 + _right(n, t, r),
    "a frame of 2**62 bytes": lambda *_: _announced(0, HUGE),
    "a frame of 1 GiB that never comes": lambda *_: _announced(0, 1 << 30) + b"x" * 1000,
    "many frames": lambda *_: _framed(MORE, b"x") * 50_000,
    "many heartbeats": lambda n, t, r: _framed(COMMAND, b"\x04PING\0\x0aabc") * 2000 + _right(n, t, r),
    "short heartbeats": lambda n, t, r: (
        b"".join(_framed(COMMAND, x) for x in (b"\x04PING", b"", b"\xff", b"\0")) + _right(n, t, r)
    ),
}

# ---- a frame of a stream: description and payload, in a reply and as it is published ----

GOOD = {"stream": "camera", "sequence": 1, "dtype": "uint8", "shape": [4], "length": 4}
FRAMES: dict[str, tuple[dict[str, object], list[bytes]]] = {
    "fewer bytes than said": ({"dtype": "float64", "shape": [100, 100], "length": 80_000}, [b"1234567"]),
    "no bytes": ({}, []),
    "a dtype that is none": ({"dtype": "__proto__"}, [b"abcd"]),
    "a dtype that is another's": ({"dtype": "constructor"}, [b"abcd"]),
    "a shape of 2**3200": ({"shape": [2**32 - 1] * 100, "length": 2**64 - 1, "sequence": 2**64 - 1}, [b"abcd"]),
}

# ---- the data socket: packets, each with the lengths of the files whose descriptors go with it ----

Packet = tuple[bytes, list[int]]
SLOT = 4096
RIGHT = Geometry(SLOT, SLOT, shape=(64, 64), depth=2, stream="x", writable=True)
BEGUN = (packets.encode_geometry(RIGHT), list[int]())
SLOTS = (Descriptor(kind=packets.SLOTS, offset=1, length=SLOT).pack(), [SLOT])
FRAME = Descriptor(kind=packets.FRAME, length=SLOT)
_WINDOW = packets.encode_window(WindowPages(0, SLOT, True, "r", "m", "c", "on", ""))

PACKETS: dict[str, list[Packet]] = {
    "nothing": [],
    "a packet of one byte": [(b"x", [])],
    "a geometry that is cut": [(BEGUN[0][:60], [])],
    "a geometry of 99 dimensions": [
        (BEGUN[0][:52] + struct.pack("=I", 99) + BEGUN[0][56:], []),
        SLOTS,
        (FRAME.pack(), []),
    ],
    "a dtype that numpy has not": [
        (packets.encode_geometry(RIGHT).replace(b"uint8\0", b"thing\0"), []),
        SLOTS,
        (FRAME.pack(), []),
    ],
    "a dtype without an end": [(BEGUN[0].replace(b"uint8" + bytes(11), b"u" * 16), []), SLOTS, (FRAME.pack(), [])],
    "slots before the geometry": [SLOTS, BEGUN, (FRAME.pack(), [])],
    "an empty slot": [BEGUN, (SLOTS[0], [0]), (FRAME.pack(), [])],
    "a slot that is too short": [BEGUN, (SLOTS[0], [SLOT - 1]), (FRAME.pack(), [])],
    "slots without descriptors": [BEGUN, (SLOTS[0], []), (FRAME.pack(), [])],
    "fewer slots than said": [
        BEGUN,
        (Descriptor(kind=packets.SLOTS, offset=3).pack(), [SLOT, SLOT]),
        (FRAME.pack(), []),
    ],
    "slots with a gap": [BEGUN, (Descriptor(5, packets.SLOTS, offset=1).pack(), [SLOT]), (FRAME.pack(), [])],
    "slots of 2**62 bytes": [(packets.encode_geometry(Geometry(HUGE, 0, stream="x")), []), SLOTS, (FRAME.pack(), [])],
    "a frame without slots": [BEGUN, (FRAME.pack(), [])],
    "a frame in no slot": [BEGUN, SLOTS, (FRAME._replace(slot=9).pack(), [])],
    "a frame behind its slot": [BEGUN, SLOTS, (FRAME._replace(offset=SLOT).pack(), [])],
    "a frame longer than its slot": [BEGUN, SLOTS, (FRAME._replace(length=HUGE).pack(), [])],
    "descriptors with every packet": [(Descriptor(kind=kind, length=SLOT).pack(), [1] * 8) for kind in range(18, 34)]
    * 20,
    "a grant of no slot": [BEGUN, SLOTS, (Descriptor(9, packets.GRANT).pack(), [])],
    "a grant twice": [BEGUN, SLOTS, *[(Descriptor(0, packets.GRANT).pack(), list[int]())] * 600],
    "a frame done that was not sent": [BEGUN, SLOTS, (Descriptor(3, packets.DONE, offset=5, sequence=99).pack(), [])],
    "a refusal that is no text": [(Descriptor(kind=packets.REFUSED).pack() + b"\xff" * 4000, [])],
    "a window without pages": [(_WINDOW, [])],
    "a window of empty files": [(_WINDOW, [0, 0])] * 20,
    "a window whose registers are no table": [(_WINDOW, [SLOT, SLOT])],
    "a table of 2**40 bytes": [(_WINDOW, [SLOT, 1 << 40])],
}


class FakeManager:
    """Serves `folder` until the end of the context. `case`: a name of one of the tables, or "" for right answers."""

    def __init__(self, folder: Path, data: bool = True) -> None:
        """`data`: with a data socket; without one, frames come over ZeroMQ."""
        self.folder = folder
        self._kinds = {"req": socket.SOCK_STREAM, "pub": socket.SOCK_STREAM}
        self._kinds |= {packets.SOCKET: socket.SOCK_SEQPACKET} if data else {}
        self.case = ""
        self._open: list[socket.socket] = []

    @contextmanager
    def serving(self) -> Iterator[FakeManager]:
        """Its sockets are there."""
        for name, kind in self._kinds.items():
            listener = socket.socket(socket.AF_UNIX, kind)
            listener.bind(str(self.folder / name))
            listener.listen(64)
            self._open.append(listener)
            threading.Thread(target=self._accept, args=(name, listener), daemon=True).start()
        try:
            yield self
        finally:
            for each in self._open:
                with suppress(OSError):
                    each.shutdown(socket.SHUT_RDWR)
                each.close()

    def _accept(self, name: str, listener: socket.socket) -> None:
        serve = {"req": self._reply, "pub": self._publish}.get(name, self._data)
        with suppress(OSError):
            while True:
                connection, _ = listener.accept()
                self._open.append(connection)
                threading.Thread(target=self._served, args=(serve, connection, self.case), daemon=True).start()

    @staticmethod
    def _served(serve: Callable[[socket.socket, str], None], connection: socket.socket, case: str) -> None:
        with suppress(OSError, EOFError):
            serve(connection, case)
            while connection.recv(1 << 16):  # until the client goes
                pass
        connection.close()

    @staticmethod
    def _shaken(connection: socket.socket, case: str, kind: bytes) -> bool:
        if case == "hangs up":
            raise EOFError
        connection.sendall(CONNECTING.get(case, GREETING))
        if case in CONNECTING:
            return False
        _exactly(connection, len(GREETING))
        _frame(connection)
        connection.sendall(_ready(kind))
        return True

    def _reply(self, connection: socket.socket, case: str) -> None:
        if not self._shaken(connection, case, b"ROUTER"):
            return
        for at in itertools.count():  # the first answer is right: the connection has to live through the next
            number, *rest = _received(connection)
            topic = rest[rest.index(b"") + 1]
            if topic == b"cm_read_data" and case in FRAMES:
                info, payload = FRAMES[case]
                reply = pb.Reply(ok=True, frame=pb.Frame(**{**GOOD, **info})).SerializeToString()  # type: ignore[arg-type]
                connection.sendall(_right(number, topic, reply, *payload))
            elif case in REPLIES and at:
                connection.sendall(REPLIES[case](number, topic, _good(topic)))
                if case == "cut off":
                    connection.shutdown(socket.SHUT_RDWR)
                    return
            else:
                connection.sendall(
                    _right(number, topic, _good(topic), *([b"abcd"] if topic == b"cm_read_data" else []))
                )

    def _publish(self, connection: socket.socket, case: str) -> None:
        if not self._shaken(connection, case, b"PUB"):
            return
        wrong = {
            "no protobuf": _message([b"cm_status", b"\xff" * 9]),
            "too few frames": _message([b"cm_status"]) + _message([b""]),
            "many frames": _framed(MORE, b"cm_status") * 50_000,
        }
        info, payload = FRAMES.get(case, ({}, [b"abcd"]))
        described = pb.Frame(**{**GOOD, **info}).SerializeToString()  # type: ignore[arg-type]
        right = pb.Frame(**GOOD).SerializeToString()  # type: ignore[arg-type]
        connection.sendall(wrong.get(case, b"") + _message([b"cm_status", STATUS]))
        connection.sendall(_message([b"cm_stream/camera", described, *payload]))
        connection.sendall(_message([b"cm_stream/camera", right, b"abcd"]))

    def _data(self, connection: socket.socket, case: str) -> None:
        connection.recv(packets.PACKET_MAX)
        for packet, lengths in PACKETS.get(case, []):
            files = [os.memfd_create("fake") for _ in lengths]
            try:
                for file, length in zip(files, lengths, strict=True):
                    os.ftruncate(file, length)
                socket.send_fds(connection, [packet], files)
            finally:
                for file in files:
                    os.close(file)
        if case == "nothing":
            raise EOFError


def _good(topic: bytes) -> bytes:
    reply = pb.Reply(ok=True)
    if topic == b"cm_status":
        reply.status.ParseFromString(STATUS)
    elif topic == b"cm_read_data":
        reply.frame.CopyFrom(pb.Frame(**GOOD))  # type: ignore[arg-type]
    elif topic == b"cm_data_config":
        reply.stream.name = "camera"
    else:
        reply.registers.values.add(name="v", value=VALUE)
    return reply.SerializeToString()


def _exactly(connection: socket.socket, count: int) -> bytes:
    data = b""
    while len(data) < count:
        more = connection.recv(count - len(data))
        if not more:
            raise EOFError
        data += more
    return data


def _frame(connection: socket.socket) -> tuple[int, bytes]:
    flags = _exactly(connection, 1)[0]
    length = struct.unpack(">Q", _exactly(connection, 8))[0] if flags & LONG else _exactly(connection, 1)[0]
    return flags, _exactly(connection, length)


def _received(connection: socket.socket) -> list[bytes]:
    parts: list[bytes] = []
    while True:
        flags, body = _frame(connection)
        if flags & COMMAND:
            continue
        parts.append(body)
        if not flags & MORE:
            return parts
