# SPDX-License-Identifier: Apache-2.0
"""How well this machine's clock is set: what chrony or PTP says about it, or else the kernel's own bound."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import time

from cm.wire.messages.fleet import ClockSync

_UNSYNCHRONISED = 0x0040  # STA_UNSYNC of adjtimex(2)
_LIMIT = 1.0  # seconds for a tool's answer


class _Timex(ctypes.Structure):
    """struct timex, as far as it is read; the kernel writes 208 bytes on 64-bit systems, 128 on 32-bit ones."""

    _fields_ = [
        ("modes", ctypes.c_uint),
        ("offset", ctypes.c_long),
        ("freq", ctypes.c_long),
        ("maxerror", ctypes.c_long),
        ("esterror", ctypes.c_long),
        ("status", ctypes.c_int),
        ("rest", ctypes.c_char * 208),
    ]


def read() -> ClockSync:
    """The state now; asks chronyd or ptp4l if their tools are installed."""
    chrony = parse_chrony(_said("chronyc", "-n", "-c", "tracking"))
    return chrony or parse_ptp(_said("pmc", "-u", "-b", "0", "GET TIME_STATUS_NP")) or kernel()


def kernel() -> ClockSync:
    """What the program that disciplines the clock told the kernel: synchronised or not, and how far it may be off."""
    timex = _Timex()
    libc = ctypes.CDLL(None, use_errno=True)
    if not hasattr(libc, "adjtimex") or libc.adjtimex(ctypes.byref(timex)) < 0:
        return ClockSync(now_ns=time.time_ns())
    synchronised = not timex.status & _UNSYNCHRONISED
    error = int(timex.maxerror) * 1000 if synchronised else 0  # µs; meaningless otherwise
    return ClockSync("kernel", synchronised, error, "", time.time_ns())


def _said(*command: str) -> str:
    if shutil.which(command[0]) is None:
        return ""
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=_LIMIT, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout if done.returncode == 0 else ""


def parse_chrony(text: str) -> ClockSync | None:
    """``chronyc -c tracking``: the error is at most |system time| + root dispersion + half the root delay.

    That is how chrony's manual bounds it. None for any other line.
    """
    parts = text.strip().split(",")
    try:
        name, stratum, offset, delay, dispersion = parts[1], int(parts[2]), *(float(parts[n]) for n in (4, 10, 11))
        leap = parts[13]
    except (IndexError, ValueError):
        return None
    synchronised = leap != "Not synchronised" and stratum > 0
    bound = abs(offset) + dispersion + delay / 2
    return ClockSync("chrony", synchronised, int(bound * 1e9) if synchronised else 0, name, time.time_ns())


def parse_ptp(text: str) -> ClockSync | None:
    """``pmc 'GET TIME_STATUS_NP'``: the offset from the master last measured. None if no port answered.

    That is of the network card's clock: phc2sys, which sets the system's by it, adds its own (under a µs).
    """
    pairs = dict(line.split(None, 1) for line in text.splitlines() if len(line.split(None, 1)) == 2)
    try:
        offset = abs(int(pairs["master_offset"]))
        present = pairs["gmPresent"].strip() == "true"
    except (KeyError, ValueError):
        return None
    master = pairs.get("gmIdentity", "").strip()
    return ClockSync("ptp4l", present, offset if present else 0, master, time.time_ns())
