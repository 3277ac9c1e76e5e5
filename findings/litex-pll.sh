#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Guess: LiteX' S7PLL sets the frequency that is asked for, or the nearest that the PLL can make.
# Seen: it takes the first dividers that come within 1 %, also where exact ones exist: a USB clock of 48 MHz runs at
# 48.387. With margin=0 it finds the exact ones, and refuses what has none. What it set is said in its log alone.
. "$(dirname "$0")/setup"
pypi litex==2024.12 migen==0.10.0
python3 - <<'END'
import logging

from litex.soc.cores.clock import S7PLL
from migen import ClockDomain, Signal
from saw import saw

logging.disable(logging.CRITICAL)


def made(source, wanted, **settings):
    """The divider, the multiplier and the output's divider, and their frequency."""
    pll = S7PLL(speedgrade=-1)
    pll.register_clkin(Signal(), source)
    try:
        pll.create_clkout(ClockDomain("out"), wanted, **settings)
        found = pll.compute_config()
    except ValueError:
        return "refused"
    dividers = found["divclk_divide"], found["clkfbout_mult"], found["clkout0_divide"]
    return dividers, round(source * dividers[1] / dividers[0] / dividers[2])


saw("48 MHz of 100", made(100e6, 48e6), ((1, 15, 31), 48387097))
saw("48 MHz of 100, margin=0", made(100e6, 48e6, margin=0), ((1, 12, 25), 48000000))
saw("65 MHz of 50", made(50e6, 65e6), ((1, 31, 24), 64583333))
saw("65 MHz of 50, margin=0", made(50e6, 65e6, margin=0), ((1, 26, 20), 65000000))
saw("148.5 MHz of 100", made(100e6, 148.5e6), ((3, 40, 9), 148148148))
saw("148.5 MHz of 100, margin=0", made(100e6, 148.5e6, margin=0), "refused")
END
