#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Guess: who subscribes late and asks for the history hears of a deletion as a deletion.
# Seen: the advanced publisher's cache gives it as a PUT of nothing. Only an empty payload tells it from a value.
. "$(dirname "$0")/setup"
pypi eclipse-zenoh==1.10.2
python3 - <<'END'
import threading
from saw import saw
from zenoh.ext import CacheConfig, HistoryConfig, declare_advanced_publisher, declare_advanced_subscriber
from zenoh_session import free_address, session

address, anywhere = free_address(), "tcp/127.0.0.1:0"


def peer():
    return session("peer", stamped=True, listen=anywhere, connect=address)


with session("router", stamped=True, listen=address), peer() as board, peer() as late:
    publisher = declare_advanced_publisher(board, "mode", cache=CacheConfig(max_samples=2), publisher_detection=True)
    publisher.put("edge")
    publisher.delete()
    told, both = [], threading.Event()

    def see(sample):
        told.append((str(sample.kind).rpartition(".")[2], sample.payload.to_string()))
        if len(told) == 2:
            both.set()

    subscriber = declare_advanced_subscriber(late, "mode", see, history=HistoryConfig(detect_late_publishers=True))
    both.wait(20)
    saw("what a late subscriber hears of a put and a deletion", told, [("PUT", "edge"), ("PUT", "")])
END
