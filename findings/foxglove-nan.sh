#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Guess: foxglove-sdk refuses a NaN in a message of JSON, or writes null.
# Seen: it writes NaN and Infinity, which are no JSON: the file is fine for Python, and JavaScript's readers, which
# show such records, end with an error at that message.
. "$(dirname "$0")/setup"
pypi foxglove-sdk==0.30.3 mcap==1.6.0
python3 - <<'END'
import foxglove

with foxglove.open_mcap("seen.mcap"):
    foxglove.log("/range", {"metres": float("nan"), "limit": float("inf")})
END
python3 - <<'END'
import json
import subprocess

from mcap.reader import make_reader
from saw import saw

with open("seen.mcap", "rb") as file:
    ((_, channel, message),) = make_reader(file).iter_messages()
saw("encoding, bytes", (channel.message_encoding, message.data), ("json", b'{"metres": NaN, "limit": Infinity}'))
saw("Python reads", sorted(json.loads(message.data)), ["limit", "metres"])
tried = "try { JSON.parse(process.argv[1]); console.log('read') } catch (error) { console.log(error.name) }"
saw("JavaScript", subprocess.run(["node", "-e", tried, message.data.decode()], capture_output=True, text=True, check=True).stdout.strip(), "SyntaxError")
END
