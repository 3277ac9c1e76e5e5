#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Guess: bitread of Project X-Ray, the usual judge of open flows, reads compressed images, as devices do.
# Seen: frames that are written by MFWR are left out, with status 0: of an image with four frames it shows one. And an
# image of its xc7frames2bit has no CRC at all, so neither a device nor a checker notices a flipped bit.
. "$(dirname "$0")/setup"
suite sid prjxray prjxray-database
PART=root/usr/share/prjxray/database/zynq7/xc7z010clg400-1/part.yaml
cat >compressed.py <<'END'
import struct

NOP, FAR, FDRI, CMD, MFWR, IDCODE = 0x20000000, 1, 2, 4, 10, 12
words = [0xFFFFFFFF] * 8 + [0x000000BB, 0x11220044, 0xFFFFFFFF, 0xFFFFFFFF, 0xAA995566, NOP]


def write(register: int, *values: int) -> None:
    words.extend([0x30000000 | register << 13 | len(values), *values, NOP])


write(CMD, 7)
write(IDCODE, 0x03722093)
write(FAR, 0x100)
write(CMD, 1)
write(FDRI, *[1] * 101, *[0] * 101)
write(CMD, 2)
for number, address in enumerate((0x101, 0x102, 0x103)):
    write(FAR, address)
    write(MFWR, *[0] * (4 if number else 8))
write(CMD, 13)
body = struct.pack(f">{len(words)}I", *words)
head = bytes.fromhex("00090ff00ff00ff00ff0000001")
for key, text in ((b"a", b"seen;UserID=0XFFFFFFFF"), (b"b", b"7z010clg400"), (b"c", b"2026/11/30"), (b"d", b"00:00:00")):
    head += key + struct.pack(">H", len(text) + 1) + text + b"\0"
open("compressed.bit", "wb").write(head + b"e" + struct.pack(">I", len(body)) + body)
open("one.frm", "w").write("0x00000100 " + ",".join(["0x00000001"] * 101) + "\n")
END
python3 compressed.py
$there root/usr/bin/bitread -part_file $PART -y -o bits compressed.bit >/dev/null
$there root/usr/bin/xc7frames2bit -part_file $PART -part_name xc7z010clg400-1 -frm_file one.frm -output_file whole.bit
python3 - <<'END'
import struct
from saw import saw

frames = {line.split("_")[1] for line in open("bits") if line.startswith("bit_")}
saw("frames of four", sorted(frames), ["00000100"])
image = open("whole.bit", "rb").read()
image = image[image.index(b"\xaa\x99\x55\x66") + 4 :]
words = iter(struct.unpack(f">{len(image) // 4}I", image))
written, register = set(), 0
for word in words:
    kind, count = word >> 29, word & 0x7FF
    if kind == 1:
        register = word >> 13 & 0x1F
    else:
        count = word & 0x7FFFFFF
    if count:
        written.add(register)
    for _ in range(count):
        next(words)
saw("registers written: CRC, FAR, FDRI, CMD, IDCODE", [number in written for number in (0, 1, 2, 4, 12)], [False, True, True, True, True])
END
