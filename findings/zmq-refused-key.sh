#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Guess: a client whose key is refused by ZAP tries again, as after every other lost connection, and is in once its key
# is enrolled.
# Seen: after the answer 400 libzmq never connects again; the socket stays, sends are taken, and nobody is told
# but a monitor. After 300 it says nothing until the handshake's time-out, and does try again.
. "$(dirname "$0")/setup"
pypi pyzmq==27.1.0
python3 - <<'END'
import threading
import time
import zmq
from saw import saw

print("pyzmq", zmq.__version__, "libzmq", zmq.zmq_version())
context = zmq.Context()
server_key, client_key = zmq.curve_keypair(), zmq.curve_keypair()
answer = {"code": b"400"}
asked = []
door = context.socket(zmq.REP)
door.bind("inproc://zeromq.zap.01")


def serve():
    while True:
        version, number, *_ = door.recv_multipart()
        asked.append(answer["code"])
        door.send_multipart([version, number, answer["code"], b"", b"", b""])


threading.Thread(target=serve, daemon=True).start()


def tries(code):
    asked.clear()
    answer["code"] = code
    server, client = context.socket(zmq.ROUTER), context.socket(zmq.DEALER)
    for end in (server, client):
        end.linger = 0
        end.handshake_ivl = 1000
    server.curve_server, (server.curve_publickey, server.curve_secretkey) = True, server_key
    port = server.bind_to_random_port("tcp://127.0.0.1")
    client.curve_serverkey, (client.curve_publickey, client.curve_secretkey) = server_key[0], client_key
    client.connect(f"tcp://127.0.0.1:{port}")
    client.send(b"hello")
    refused = time.monotonic() + 4
    while time.monotonic() < refused:
        time.sleep(0.1)
    before = len(asked)
    answer["code"] = b"200"  # the key is enrolled
    arrived = bool(server.poll(6000))
    server.close()
    client.close()
    return before > 1, arrived


saw("400: asked more than once, and in when it is enrolled", tries(b"400"), (False, False))
saw("300", tries(b"300"), (True, True))
END
