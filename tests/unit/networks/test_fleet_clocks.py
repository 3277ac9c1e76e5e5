# SPDX-License-Identifier: Apache-2.0
"""How well clocks are set: by output of chronyd 4.3 and ptp4l 3.1.1, and for several boards together."""

from __future__ import annotations

import time

from cm.networks.fleet.bridge import clock
from cm.networks.fleet.status_text import said_apart
from cm.wire.messages.fleet import ClockSync

ALONE = "7F7F0101,,8,1795359102.231335873,0.000000000,0.000000000,0.000000000,0.000,0.000,0.000,0.000000000,0.000000000,0.0,Normal\n"  # noqa: E501
# The same line as chronyd has it behind a server: its fields are those of `chronyc tracking`, in their order.
FOLLOWS = "C0000201,192.0.2.1,3,1795359102.2,-0.000020000,0.0,0.0,0.0,0.0,0.0,0.001000000,0.000300000,64.2,Normal\n"
LOST = "00000000,,0,0.0,0.000000000,0.0,0.0,0.0,0.0,0.0,1.000000000,1.000000000,0.0,Not synchronised\n"
MASTER = """sending: GET TIME_STATUS_NP
\t000000.fffe.000000-0 seq 0 RESPONSE MANAGEMENT TIME_STATUS_NP
\t\tmaster_offset              0
\t\tingress_time               0
\t\tcumulativeScaledRateOffset +0.000000000
\t\tscaledLastGmPhaseChange    0
\t\tgmTimeBaseIndicator        0
\t\tlastGmPhaseChange          0x0000'0000000000000000.0000
\t\tgmPresent                  false
\t\tgmIdentity                 000000.fffe.000000
"""


def test_chrony_bounds_the_error_by_offset_dispersion_and_half_the_delay() -> None:
    found = clock.parse_chrony(FOLLOWS)
    assert found is not None
    assert (found.source, found.synchronised, found.reference) == ("chrony", True, "192.0.2.1")
    assert found.error_ns == 820_000  # 20 + 300 + 1000 / 2 µs


def test_chrony_without_a_source_promises_nothing() -> None:
    alone, lost = clock.parse_chrony(ALONE), clock.parse_chrony(LOST)
    assert alone is not None
    assert lost is not None
    assert (alone.synchronised, alone.error_ns) == (True, 0)
    assert (lost.synchronised, lost.error_ns) == (False, 0)
    assert clock.parse_chrony("506 Cannot talk to daemon\n") is None


def test_a_ptp_master_follows_no_clock_and_a_slave_tells_its_offset() -> None:
    master = clock.parse_ptp(MASTER)
    slave = clock.parse_ptp(
        MASTER.replace("false", "true").replace("master_offset              0", "master_offset -85")
    )
    assert master is not None
    assert slave is not None
    assert (master.synchronised, slave.synchronised, slave.error_ns) == (False, True, 85)
    assert clock.parse_ptp("sending: GET TIME_STATUS_NP\n") is None


def test_the_kernel_always_has_an_estimate() -> None:
    found = clock.kernel()
    assert found.source == "kernel"
    assert abs(found.now_ns - time.time_ns()) < 60 * 10**9
    assert found.error_ns == 0 or found.synchronised


def test_the_two_worst_clocks_add_up_and_one_that_cannot_tell_spoils_the_promise() -> None:
    clocks = {name: ClockSync("chrony", True, error) for name, error in (("a", 100), ("b", 700), ("c", 30))}
    assert said_apart(clocks) == 800
    assert said_apart({**clocks, "d": ClockSync("kernel", False)}) is None
    assert said_apart({**clocks, "d": ClockSync("chrony", True, 0)}) is None
