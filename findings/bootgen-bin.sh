#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Guess: `bootgen -process_bitstream bin -o FILE` writes the words of the .bit, swapped for a Zynq-7000, to FILE.
# Seen: for a Zynq-7000 NOP words follow up to a multiple of 32 bytes, so that its .bin is not the .bit's image byte for
# byte; for a ZynqMP nothing is added. The file lies beside the .bit, whatever -o says.
. "$(dirname "$0")/setup"
debian xilinx-bootgen
cat >made.py <<'END'
import struct
import sys
from pathlib import Path


def text(letter: bytes, value: str) -> bytes:
    data = value.encode() + b"\0"
    return letter + struct.pack(">H", len(data)) + data


WORDS = [0xFFFFFFFF] * 8 + [0x000000BB, 0x11220044, 0xFFFFFFFF, 0xFFFFFFFF, 0xAA995566, 0x20000000, 0x30008001, 0xD, 0x20000000]
BODY = struct.pack(f">{len(WORDS)}I", *WORDS)


def write(part: str) -> None:
    begin = bytes.fromhex("00090ff00ff00ff00ff0000001")
    names = text(b"a", "design;UserID=0XFFFFFFFF;Version=2022.2") + text(b"b", part)
    rest = text(b"c", "2026/11/29") + text(b"d", "12:00:00") + b"e" + struct.pack(">I", len(BODY))
    Path("design.bit").write_bytes(begin + names + rest + BODY)


if __name__ == "__main__":
    write(sys.argv[1])
END
printf 'all:\n{\n\tdesign.bit\n}\n' >all.bif
export PYTHONPATH="$folder:$PYTHONPATH"
for pair in zynq:7z020clg400 zynqmp:xczu7ev-ffvc1156-2-e; do
	python3 made.py "${pair#*:}"
	bootgen -arch "${pair%%:*}" -image all.bif -process_bitstream bin -o named.bin -w on >"said.${pair%%:*}" || cat "said.${pair%%:*}"
	test ! -e named.bin && mv design.bit.bin "${pair%%:*}.bin"
done
python3 - <<'END'
import struct
from pathlib import Path
from made import BODY, WORDS
from saw import saw
nop = 0x20000000
padded = WORDS + [nop] * (-len(WORDS) % 8)
saw("words of the image", len(WORDS), 17)
saw("Zynq-7000: words of the .bin", Path("zynq.bin").stat().st_size // 4, 24)
saw("they are the words swapped, and NOPs", Path("zynq.bin").read_bytes() == struct.pack("<24I", *padded), True)
saw("ZynqMP: words of the .bin", Path("zynqmp.bin").stat().st_size // 4, 17)
saw("ZynqMP: they are swapped", Path("zynqmp.bin").read_bytes() == struct.pack("<17I", *WORDS), True)
END
