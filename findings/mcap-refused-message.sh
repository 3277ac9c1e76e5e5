#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Guess: a message that mcap's writer refuses with an exception is not in the file, and those after it are.
# Seen: the messages after it in the same chunk are read back as one, with a time that nobody gave, and no error. And a
# reader checks no CRC unless it is asked: a bit that flipped comes as data.
. "$(dirname "$0")/setup"
pypi mcap==1.6.0
python3 - <<'END'
import io
import struct
from mcap.reader import make_reader
from mcap.stream_reader import CRCValidationError
from mcap.writer import CompressionType, Writer
from saw import saw


def record(messages):
    file = io.BytesIO()
    writer = Writer(file, compression=CompressionType.NONE)
    writer.start()
    channel = writer.register_channel("speed", "json", writer.register_schema("speed", "jsonschema", b"{}"))
    refused = 0
    for time, sequence, data in messages:
        try:
            writer.add_message(channel, time, data, time, sequence)
        except struct.error:
            refused += 1
    writer.finish()
    return bytearray(file.getvalue()), refused


def read(content, **options):
    return [(message.log_time, message.data) for _, _, message in make_reader(io.BytesIO(content), **options).iter_messages()]


content, refused = record([(10, 0, b"one"), (20, 1 << 32, b"two"), (30, 2, b"three"), (40, 3, b"four")])
back = read(content)
saw("refused", refused, 1)
saw("messages that come back, and the first of them", (len(back), back[0]), (2, (10, b"one")))
saw("the second has two in it, and a time of its own", (b"three" in back[1][1], b"four" in back[1][1], back[1][0] in (30, 40)), (True, True, False))

content, _ = record([(10, 0, b"speed=100")])
content[content.index(b"speed=100") + 6] ^= 8
saw("a flipped bit", read(content), [(10, b"speed=900")])
try:
    told = bool(read(content, validate_crcs=True)) and False
except CRCValidationError:
    told = True
saw("with validate_crcs it is told", told, True)
END
