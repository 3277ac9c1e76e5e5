#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Guess: a router hands on between all that are connected to it, in whatever mode.
# Seen: nothing goes between two peers, which is the mode of a new configuration. They are expected to reach each other;
# where they cannot (behind a firewall, in containers), put() and get() succeed, and nothing comes. One of them being a
# client is enough.
. "$(dirname "$0")/setup"
pypi eclipse-zenoh==1.10.2
python3 - <<'END'
import json
import time

import zenoh
from saw import saw
from zenoh_session import free_address, session

address = free_address()


def member(mode, listens):
    settings = {"scouting/multicast/enabled": False, "connect/endpoints": [address], "listen/endpoints": listens}
    config = zenoh.Config()
    for name, value in (settings | ({"mode": mode} if mode else {})).items():
        config.insert_json5(name, json.dumps(value))
    return zenoh.open(config)


def hears(one, other, listens=()):
    """What a subscriber, and what an asker, gets within five seconds."""
    with member(one, listens) as board, member(other, listens) as desk:
        heard = []
        board.declare_queryable("mode/now", lambda query: query.reply("mode/now", "edge"))
        desk.declare_subscriber("mode/changed", lambda sample: heard.append(sample.payload.to_string()))
        end = time.monotonic() + 5
        while time.monotonic() < end and not heard:
            board.put("mode/changed", "edge")
            time.sleep(0.1)
        return heard[:1], [reply.ok.payload.to_string() for reply in desk.get("mode/now")]


with session("router", listen=address):
    saw("no mode set", hears(None, None), ([], []))
    saw("peer and peer", hears("peer", "peer"), ([], []))
    saw("peer and client", hears("peer", "client"), (["edge"], ["edge"]))
    saw("client and client", hears("client", "client"), (["edge"], ["edge"]))
    saw("peers that can reach each other", hears("peer", "peer", listens=["tcp/127.0.0.1:0"]), (["edge"], ["edge"]))
END
