#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Guess: readers of one format give the messages of a window alike, and those of one time in the order of the file.
# Seen: endTime of @mcap/core is in the window, end_time of mcap and of small-mcap is not. small-mcap sorts messages of
# one time and chunk by channel, so what was written together on two topics is not in its order.
. "$(dirname "$0")/setup"
pypi mcap==1.6.0 small-mcap==0.16.0
npm install --silent --no-fund --no-audit @mcap/core@2.2.2 @mcap/nodejs@1.0.2
python3 - <<'END'
from mcap.writer import CompressionType, Writer

for name, times in (("window", (1, 2, 3, 4)), ("together", (7,) * 6)):
    with open(f"{name}.mcap", "wb") as file:
        writer = Writer(file, compression=CompressionType.NONE)
        writer.start()
        topics = [writer.register_channel(topic, "raw", 0) for topic in ("/a", "/b")]
        for number, time in enumerate(times):
            writer.add_message(topics[number % 2], time, b"%d" % number, time)
        writer.finish()
END
cat >read.mjs <<'END'
import { open } from "node:fs/promises";
import { McapIndexedReader } from "@mcap/core";
import { FileHandleReadable } from "@mcap/nodejs";

const [, , name, ...window] = process.argv;
const file = await open(`${name}.mcap`);
const reader = await McapIndexedReader.Initialize({ readable: new FileHandleReadable(file) });
const [startTime, endTime] = window.map(BigInt);
const seen = [];
for await (const message of reader.readMessages({ startTime, endTime })) seen.push(Number(new TextDecoder().decode(message.data)));
console.log(JSON.stringify(seen));
await file.close();
END
WINDOW=$(node read.mjs window 2 3) TOGETHER=$(node read.mjs together) python3 -W ignore - <<'END'
import json
import os

import small_mcap
from mcap.reader import make_reader
from saw import saw


def by_mcap(name, **window):
    with open(f"{name}.mcap", "rb") as file:
        return [int(message.data) for _, _, message in make_reader(file).iter_messages(**window)]


def by_small_mcap(name, **window):
    with open(f"{name}.mcap", "rb") as file:
        return [int(bytes(message.data)) for _, _, message in small_mcap.read_message(file, **window)]


saw("from 2 to 3, mcap", by_mcap("window", start_time=2, end_time=3), [1])
saw("from 2 to 3, small-mcap", by_small_mcap("window", start_time_ns=2, end_time_ns=3), [1])
saw("from 2 to 3, @mcap/core", json.loads(os.environ["WINDOW"]), [1, 2])
saw("of one time, mcap", by_mcap("together"), [0, 1, 2, 3, 4, 5])
saw("of one time, small-mcap", by_small_mcap("together"), [0, 2, 4, 1, 3, 5])
saw("of one time, @mcap/core", json.loads(os.environ["TOGETHER"]), [0, 1, 2, 3, 4, 5])
END
