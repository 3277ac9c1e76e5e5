# SPDX-License-Identifier: Apache-2.0
"""Ways in which a client can try to keep a manager from serving others; bounded in count, for this machine only.

``python tests/attacks.py NAME RUNTIME_DIR ROUNDS [ADDRESS KEYS]``: prints how often it did what, as JSON.
"""

from __future__ import annotations

import json
import os
import random
import signal
import socket
import subprocess
import sys
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import zmq

from cm.server.rights.keys import read_key_file
from cm.wire import plane_packets as packets
from cm.wire.encode import decode_reply, encode_request
from cm.wire.messages import requests as rq
from cm.wire.plane_packets import Descriptor, Open, Purpose, encode_open

PATIENCE = 60_000  # milliseconds until a reply is missed
MODES = ("default", "edge_detection", "colorise")
SHAPES = ((480, 640), (240, 320), (1080, 1920), (1, 64), (100,))
CAMERA = Path(__file__).resolve().parents[1] / "cm" / "data" / "camera" / "camera.yaml"

# Reads some frames, or sends requests and reads nothing, and then stops.
STOPS = {
    "reader": "board = cm.connect(runtime_dir=sys.argv[1], timeout=60); stream = board.stream('camera', depth=64); "
    "frames = [stream.read() for _ in range(3)]",
    "asker": "import zmq; made = [zmq.Context.instance().socket(zmq.DEALER) for _ in range(40)]; "
    "[one.connect('ipc://' + sys.argv[1] + '/req') for one in made]; "
    "[one.send_multipart([b'', b'cm_status', b'']) for one in made for _ in range(200)]",
}

# Connects so often, to a path, or from another address of this machine to a port, and hangs up at once.
CONNECTS = """
import socket, struct, sys
family, place, count = (socket.AF_UNIX, socket.AF_INET)[sys.argv[1].isdigit()], sys.argv[1], int(sys.argv[2])
if family == socket.AF_INET:
    place = "127.0.0.1", int(place)
done = 0
for done in range(1, count + 1):
    with socket.socket(family) as one:
        try:
            if family == socket.AF_INET:
                one.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))  # no port stays in use
                one.bind(("127.0.0.2", 0))
            one.connect(place)
        except OSError:
            pass
print(done)
"""


def connecting(place: str, count: int) -> subprocess.Popen[str]:
    """A process that does so."""
    words = [sys.executable, "-S", "-E", "-c", CONNECTS, place, str(count)]
    return subprocess.Popen(words, stdout=subprocess.PIPE, text=True)


def greeting(mechanism: bytes) -> bytes:
    """ZMTP 3.0's."""
    return b"\xff" + bytes(8) + b"\x7f\x03\x00" + mechanism.ljust(20, b"\0") + bytes(32)


def handshake(kind: bytes) -> bytes:
    """A peer's half of the handshake without keys."""
    ready = b"\x05READY\x0bSocket-Type" + len(kind).to_bytes(4, "big") + kind
    return greeting(b"NULL") + bytes([4, len(ready)]) + ready


class Attacker:
    """The attacks of one process."""

    def __init__(self, runtime: str, rounds: int, address: str = "", keys: str = "") -> None:
        self.runtime, self.rounds = runtime, rounds
        self.port = int(address.rpartition(":")[2] or 0)
        self.keys = keys
        self.did = Counter[str]()
        self.random = random.Random(1)
        self.context = zmq.Context()
        self.context.set(zmq.MAX_SOCKETS, 4096)

    # ---- means ------------------------------------------------------------------------------

    def dealer(self, kind: int = zmq.DEALER, name: str = "req") -> Any:
        made = self.context.socket(kind)
        made.linger = made.sndhwm = made.rcvhwm = 0
        made.connect(f"ipc://{self.runtime}/{name}")
        return made

    def with_keys(self, keys: dict[str, bytes]) -> Any:
        made = self.context.socket(zmq.DEALER)
        made.linger = made.sndhwm = 0
        made.curve_serverkey = keys["server-public"]
        made.curve_publickey, made.curve_secretkey = keys["public"], keys["secret"]
        return made

    def raw(self, name: str = "req") -> socket.socket:
        made = socket.socket(socket.AF_UNIX)
        made.connect(f"{self.runtime}/{name}")
        made.settimeout(60)  # not before: connect() would not wait for its turn
        return made

    def data(self, wanted: Open | None) -> socket.socket:
        made = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        made.connect(f"{self.runtime}/data")
        made.settimeout(60)
        if wanted is not None:
            made.send(encode_open(wanted))
        return made

    def tcp(self) -> socket.socket:
        return socket.create_connection(("127.0.0.1", self.port), timeout=60)

    def asking(self, make: Callable[[int], rq.Request], ahead: int = 16, connections: int = 2) -> None:
        """Send requests, several ahead over each connection, and count the outcomes."""
        made = [self.dealer() for _ in range(connections)]
        poller, asked, answered = zmq.Poller(), 0, 0
        for one in made:
            poller.register(one, zmq.POLLIN)
            for _ in range(ahead):
                one.send_multipart([b"", *encode_request(make(asked))])
                asked += 1
        while answered < asked:
            ready = poller.poll(PATIENCE)
            assert ready, "an answer is missed"
            for one, _ in ready:
                error = decode_reply(one.recv_multipart()[1:]).error
                self.did[error.code if error else "ok"] += 1
                answered += 1
                if asked < self.rounds * 20:
                    one.send_multipart([b"", *encode_request(make(asked))])
                    asked += 1

    # ---- ways -------------------------------------------------------------------------------

    def change_modes(self) -> None:
        self.asking(lambda i: rq.ChangeMode("camera", MODES[i % 3], no_wait=True), 64, 8)

    def change_and_cancel(self) -> None:
        self.asking(lambda i: rq.CancelChange() if i % 2 else rq.ChangeMode("camera", MODES[i % 3], no_wait=True))

    def plan(self) -> None:
        self.asking(lambda i: rq.PlanChange("camera", MODES[i % 3]), 64, 4)

    def configure_a_stream(self) -> None:
        self.asking(lambda i: rq.ConfigureStream("from_pl", shape=SHAPES[i % 5], slots=1 + i % 64, force=True), 4)

    def define_memories(self) -> None:
        self.asking(lambda i: rq.DefineMemory(f"m{i}", 0x1000 + i * 4 % 0x800, length=4 << i % 8, region="static"), 32)

    def begin_uploads(self) -> None:
        self.asking(lambda i: rq.Upload(f"u{i}", 4 << 20, offset=0, data=bytes(1 << 20)), 4)

    def take_leases(self) -> None:
        self.asking(lambda i: rq.TakeLease("registers:zoom", exclusive=False, seconds=0.05 + i % 2))

    def send_configurations(self) -> None:
        text = CAMERA.read_text("utf-8")

        def make(i: int) -> rq.Request:
            name = f"sent{i % 30}"
            return rq.Provision(text.replace("name: camera", f"name: {name}", 1)) if i % 3 else rq.RemoveConfig(name)

        self.asking(make)

    def leave_amid_messages(self) -> None:
        for _ in range(self.rounds):
            for name, kind in (("req", b"DEALER"), ("sub", b"PUB"), ("pub", b"SUB")):
                with self.raw(name) as peer, suppress(OSError):
                    parts = self.random.randrange(1, 200) * (b"\x01\xc8" + bytes(200))
                    peer.sendall(handshake(kind) + parts + b"\x03" + (1 << 20).to_bytes(8, "big") + bytes(30_000))
                    self.did[name] += 1

    def shake_hands(self) -> None:
        for _ in range(self.rounds * 10):
            with self.raw() as peer, suppress(OSError):
                peer.sendall(handshake(b"DEALER"))
                peer.recv(64)
                self.did["connected"] += 1

    def connect_without_end(self) -> None:
        """From several processes, to ipc and TCP."""
        made = [connecting(f"{self.runtime}/req", self.rounds * 200) for _ in range(4)]
        made += [connecting(str(self.port), self.rounds) for _ in range(2)]  # which takes longer, as TCP tries again
        for process in made:
            said, _ = process.communicate()
            self.did["connected"] += int(said)

    def subscribe_again(self) -> None:
        topics = b"".join(bytes([0, 11]) + b"\x01cm_%07d" % i for i in range(1000))
        for _ in range(self.rounds):
            with self.raw("pub") as peer, suppress(OSError):
                peer.sendall(handshake(b"SUB") + topics)
                self.did["sent"] += 1
                peer.recv(64)

    def open_streams(self) -> None:
        for i in range(self.rounds):
            with self.data(Open("camera", depth=(1, 64, 255)[i % 3])) as peer, suppress(OSError):
                if i % 2:
                    peer.recv(4096)
                self.did["opened"] += 1

    def allocate(self) -> None:
        for i in range(self.rounds // 8):
            with (
                self.data(Open("", Purpose.ALLOCATE, length=(1, 16 << 20, 64 << 20)[i % 3])) as peer,
                suppress(OSError),
            ):
                peer.recv(4096)
                self.did["allocated"] += 1

    def repeat_packets(self) -> None:
        """Each kind of packet of the data socket, as fast as they are taken, from readers of a stream."""
        for kind in (packets.RELEASE, packets.SUBMIT, packets.PING, packets.LEAVE):
            with self.data(Open("camera", depth=1)) as peer, suppress(OSError):
                epoch = Descriptor(*packets.DESCRIPTOR.unpack_from(peer.recv(4096))).flags
                packet = Descriptor(kind=kind, slot=7, flags=epoch).pack()
                for _ in range(self.rounds * 100):
                    peer.send(packet)
                    self.did[f"packet {kind}"] += 1
                    with suppress(BlockingIOError):
                        while peer.recv(4096, socket.MSG_DONTWAIT):
                            pass

    def connect_and_say_nothing(self) -> None:
        held = [self.data(None) for _ in range(self.rounds * 2)]
        self.did["connected"] += len(held)

    def read_nothing_through_tiny_buffers(self) -> None:
        held = []
        for i in range(100):
            peer = self.raw("pub" if i % 2 else "req")
            for which in (socket.SO_RCVBUF, socket.SO_SNDBUF):
                peer.setsockopt(socket.SOL_SOCKET, which, 1)
            peer.sendall(handshake(b"SUB") + b"\x00\x01\x01" if i % 2 else handshake(b"DEALER"))
            peer.setblocking(False)
            held.append(peer)
        for _ in range(self.rounds):
            for peer in held:
                with suppress(OSError):
                    peer.send(b"\x01\x00\x01\x09cm_status\x00\x00")
                    self.did["sent"] += 1

    def try_wrong_keys(self) -> None:
        right = read_key_file(Path(self.keys))
        for _ in range(self.rounds // 4):
            public, secret = zmq.curve_keypair()
            with self.with_keys({**right, "public": public, "secret": secret}) as one:
                monitor = one.get_monitor_socket(zmq.EVENT_HANDSHAKE_FAILED_AUTH)
                one.connect(f"tcp://127.0.0.1:{self.port}")
                self.did["refused" if monitor.poll(PATIENCE) else "not told"] += 1
                one.disable_monitor()
                monitor.close(0)

    def begin_with_keys(self) -> None:
        """Send a client's HELLO again and again, whole or in pieces; a connection that gets an answer is closed."""
        whole = greeting(b"CURVE") + self._hello()
        held = [self.tcp() for _ in range(100)]
        for peer in held:
            with suppress(OSError):
                peer.sendall(whole[: self.random.randrange(1, len(whole))])
        for _ in range(self.rounds * 4):
            with self.tcp() as peer, suppress(OSError):
                peer.sendall(whole)
                peer.recv(4096)
                self.did["begun"] += 1

    def _hello(self) -> bytes:
        with (
            socket.create_server(("127.0.0.1", 0)) as server,
            self.with_keys(read_key_file(Path(self.keys))) as client,
        ):
            client.connect(f"tcp://127.0.0.1:{server.getsockname()[1]}")
            peer, _ = server.accept()
            with peer:
                peer.sendall(greeting(b"CURVE")[:63] + b"\0")
                got = b""
                while len(got) < 64 + 202:
                    got += peer.recv(4096)
                return got[64:]

    def stop(self) -> None:
        """Stop processes that hold slots or leave replies unread."""
        then = f"os.kill({os.getpid()}, signal.SIGUSR1); signal.raise_signal(signal.SIGSTOP)"
        words = f"import cm, os, signal, sys; {{}}; {then}"
        stopped = [signal.SIGUSR1]
        signal.pthread_sigmask(signal.SIG_BLOCK, stopped)
        made = []
        for code in (STOPS["reader"], STOPS["asker"]) * 3:
            made.append(subprocess.Popen([sys.executable, "-c", words.format(code), self.runtime]))
            signal.sigtimedwait(stopped, PATIENCE / 1000)
            self.did["stopped"] += 1
        for process in made:
            process.kill()
            process.wait()


ATTACKS = (
    "change_modes", "change_and_cancel", "plan", "configure_a_stream", "define_memories", "begin_uploads",
    "take_leases", "send_configurations", "leave_amid_messages", "shake_hands", "connect_without_end",
    "subscribe_again", "open_streams", "allocate", "repeat_packets", "connect_and_say_nothing",
    "read_nothing_through_tiny_buffers", "try_wrong_keys", "begin_with_keys", "stop",
)  # fmt: skip


def main(name: str, runtime: str, rounds: str, *more: str) -> None:
    """Run one attack."""
    attacker = Attacker(runtime, int(rounds), *more)
    print("begun", flush=True)
    getattr(attacker, name)()
    print(json.dumps(attacker.did), flush=True)
    os._exit(0)  # so that what it holds is not given back properly


if __name__ == "__main__":
    main(*sys.argv[1:])
