#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Guess: an answer that scipy's milp calls optimal keeps its constraints, whatever unit they are written in.
# Seen: HiGHS' tolerance of 1e-6 is absolute. Two steps of 0.3 us and 0.4 us "fit" into 0.5 us where they are written in
# seconds, with status 0; in microseconds they do not.
. "$(dirname "$0")/setup"
pypi numpy==2.3.5 scipy==1.16.3
python3 - <<'END'
import numpy
from saw import saw
from scipy.optimize import Bounds, LinearConstraint, milp


def steps(unit: float) -> tuple[int, int]:
    """How many of two steps are done within 0.5 us, and milp's status; `unit` microseconds are 1."""
    times = numpy.array([[0.3, 0.4]]) / unit
    found = milp([-1, -1], constraints=LinearConstraint(times, ub=0.5 / unit), integrality=[1, 1], bounds=Bounds(0, 1))
    return round(found.x.sum()), found.status


saw("in microseconds", steps(1.0), (1, 0))
saw("in milliseconds", steps(1e3), (1, 0))
saw("in seconds", steps(1e6), (2, 0))
END
