#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Guess: a get with QueryTarget.ALL gives every queryable's answer.
# Seen: where two boards answer under one key, the default consolidation gives one of them. A deletion comes to a
# subscriber without the time stamp that the put before it had from the router.
. "$(dirname "$0")/setup"
pypi eclipse-zenoh==1.10.2
python3 - <<'END'
import threading
import zenoh
from saw import saw
from zenoh_session import free_address, session

address = free_address()
with session("router", listen=address):
    boards = [session("client", connect=address) for _ in range(2)]
    for number, board in enumerate(boards):
        board.declare_queryable("all/status", lambda query, n=number: query.reply("all/status", f"board {n}"))
    asking = session("client", connect=address)

    def answers(**options):
        replies = asking.get("all/status", target=zenoh.QueryTarget.ALL, **options)
        return sorted(reply.ok.payload.to_string() for reply in replies)

    while len(answers(consolidation=zenoh.ConsolidationMode.NONE)) < 2:  # until both are known everywhere
        pass
    saw("answers of two boards", len(answers()), 1)
    saw("with ConsolidationMode.NONE", answers(consolidation=zenoh.ConsolidationMode.NONE), ["board 0", "board 1"])

    told, both = [], threading.Event()

    def see(sample):
        told.append((str(sample.kind).rpartition(".")[2], sample.timestamp is not None))
        if told[-1][0] == "DELETE":
            both.set()

    with asking.declare_subscriber("wanted/**", see):
        while not both.wait(0.5):
            told.clear()
            boards[0].put("wanted/mode", "edge")
            boards[0].delete("wanted/mode")
    saw("kind, and whether it has a time", told[-2:], [("PUT", True), ("DELETE", False)])
    for board in (*boards, asking):
        board.close()
END
