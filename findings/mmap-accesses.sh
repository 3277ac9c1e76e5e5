#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Guess: four bytes at an aligned place of a mapping are one access, whichever of Python's ways writes or reads them.
# Seen: of the four ways only memoryview.cast is. A slice is stored twice and loaded twice (glibc copies four bytes by two
# moves that overlap); struct.pack_into stores twice before the value, zeros, also where it then refuses the value; and
# ctypes loads before it stores. A FIFO's register takes two words, and one that a read clears is lost by a write.
. "$(dirname "$0")/setup"
debian valgrind
cat >ways.py <<'END'
import ctypes
import mmap
import platform
import struct

device = mmap.mmap(-1, mmap.PAGESIZE)
words, number = memoryview(device).cast("I"), ctypes.c_uint32.from_buffer(device)
four, value = b"abcd", 0x11223344


def write_slice():
    device[0:4] = four


def write_cast():
    words[0] = value


def write_ctypes():
    number.value = value


ways = {
    "write a slice": write_slice,
    "read a slice": lambda: device[0:4],
    "struct.pack_into": lambda: struct.pack_into("<I", device, 0, value),
    "struct.unpack_from": lambda: struct.unpack_from("<I", device, 0),
    "write memoryview.cast": write_cast,
    "read memoryview.cast": lambda: words[0],
    "write ctypes": write_ctypes,
    "read ctypes": lambda: number.value,
}
print("VERSIONS", "Python", platform.python_version(), "glibc", platform.libc_ver()[1])
print("BASE", ctypes.addressof(number), flush=True)
for name, way in ways.items():
    print("WAY", name, flush=True)
    way()
END
export VALGRIND_LIB="$folder/root/usr/libexec/valgrind"
cat >seen.py <<'END'
import sys

from saw import saw

base, seen, at = 0, {}, None
for line in sys.stdin:
    kind, _, rest = line.strip().partition(" ")
    if kind == "VERSIONS":
        print(rest)
    elif kind == "BASE":
        base = int(rest)
    elif kind == "WAY":
        at = seen.setdefault(rest, [])
    elif kind in ("L", "S") and base:
        address, _, size = rest.strip().partition(",")
        if base <= int(address, 16) < base + 4:
            at.append(kind + size)
for name, before in {
    "write a slice": "S4 S4", "read a slice": "L4 L4",
    "struct.pack_into": "S4 S4 S4", "struct.unpack_from": "L4",
    "write ctypes": "L4 S4", "read ctypes": "L4",
    "write memoryview.cast": "S4", "read memoryview.cast": "L4",
}.items():
    saw(name, " ".join(seen[name]), before)
END
valgrind --tool=lackey --trace-mem=yes --log-fd=1 /usr/bin/python3 -S -I ways.py | grep -v '^I' | python3 seen.py
/usr/bin/python3 - <<'END'
import struct

from saw import saw

register = bytearray(4 * b"\xff")
try:
    struct.pack_into("<I", register, 0, 2**32)
except struct.error:
    saw("after a value that pack_into refuses", bytes(register), bytes(4))
END
