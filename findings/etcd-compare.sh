#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Guess: comparing the value of a key that is not there is like comparing an empty one, so either "equal" or "not equal"
# holds; and a lease of 0 seconds is refused.
# Seen: both comparisons are false, so a transaction that is guarded by either does nothing; the lease is granted for 2.
. "$(dirname "$0")/setup"
debian etcd-server
python3 - <<'END'
import base64
import json
import socket
import subprocess
import time
import urllib.error
import urllib.request
from saw import saw


def free_port():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


client, peer = (f"http://127.0.0.1:{free_port()}" for _ in range(2))
store = subprocess.Popen(
    ["etcd", "--data-dir", "data", "--listen-client-urls", client, "--advertise-client-urls", client,
     "--listen-peer-urls", peer, "--initial-advertise-peer-urls", peer, "--initial-cluster", f"default={peer}"],
    stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
)


def ask(path, **fields):
    request = urllib.request.Request(client + path, json.dumps(fields).encode())
    with urllib.request.urlopen(request, timeout=10) as reply:
        return json.load(reply)


def coded(text):
    return base64.b64encode(text.encode()).decode()


try:
    for _ in range(100):
        try:
            ask("/v3/maintenance/status")
            break
        except (urllib.error.URLError, ConnectionError):
            time.sleep(0.1)

    def holds(result, value):
        compare = {"key": coded("missing"), "target": "VALUE", "result": result, "value": coded(value)}
        return ask("/v3/kv/txn", compare=[compare]).get("succeeded", False)

    saw("the missing key is equal to nothing", holds("EQUAL", ""), False)
    saw("it is not equal to nothing", holds("NOT_EQUAL", ""), False)
    saw("it is not equal to x", holds("NOT_EQUAL", "x"), False)
    saw("a lease of 0 s", ask("/v3/lease/grant", TTL="0")["TTL"], "2")
finally:
    store.kill()
    store.wait()
END
