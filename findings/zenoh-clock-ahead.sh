#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Guess: the time stamp that a publisher sets comes to a subscriber as it was set, whatever the router's clock says.
# Seen: of a publisher whose clock is behind it does. Of one that is ahead, the router puts its own time in its place,
# without a word: only boards whose clocks are late look late.
. "$(dirname "$0")/setup"
debian libfaketime
pypi eclipse-zenoh==1.10.2
cat >publish.py <<'END'
import select
import sys

from zenoh_session import session

with session("client", stamped=True, connect=sys.argv[1]) as board:
    for _ in range(5):
        board.put("board/tick", "")
        select.select([], [], [], 0.2)  # time.sleep does not work beside libfaketime
END
FAKETIME_LIBRARY=$(find "$folder/root" -name libfaketime.so.1) python3 - <<'END'
import os
import subprocess
import sys
import threading
import time

from saw import saw
from zenoh_session import free_address, session

seen = {}
for shift in ("-10s", "+10s"):
    address, came, arrived = free_address(), [], threading.Event()

    def see(sample):
        came.append(sample.timestamp.get_time().timestamp() - time.time())
        arrived.set()

    faked = {"LD_PRELOAD": os.environ["FAKETIME_LIBRARY"], "FAKETIME": shift, "FAKETIME_DONT_FAKE_MONOTONIC": "1"}
    with session("router", stamped=True, listen=address), session("client", connect=address) as listening:
        with listening.declare_subscriber("board/tick", see):
            while not arrived.is_set():
                subprocess.run([sys.executable, "publish.py", address], env=os.environ | faked, timeout=60, check=True)
    seen[shift] = round(came[-1] / 10) * 10
saw("seconds from a subscriber's clock, by the publisher's", seen, {"-10s": -10, "+10s": 0})
END
