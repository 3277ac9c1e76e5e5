# SPDX-License-Identifier: Apache-2.0
"""Stands in for yosys and nextpnr where only the order of the flow's steps is tested: empty netlists, empty routes.

CM_STAND_IN is a JSON object: the runs that end with an error, by their name, each with the seeds and the error.
"""

from __future__ import annotations

import json
import os
import sys
from itertools import pairwise
from pathlib import Path


def yosys(arguments: list[str]) -> None:
    """Write what the script asks for."""
    script = Path(arguments[arguments.index("-s") + 1]).read_text().split()
    top = script[script.index("-top") + 1]
    empty = {"modules": {top: {"cells": {}, "netnames": {}, "ports": {}}}}
    Path(script[script.index("write_json") + 1]).write_text(json.dumps(empty))


def nextpnr(arguments: list[str]) -> None:
    """Write nothing routed, or end with an error."""
    job = json.loads(Path(os.environ["CM_OPEN_JOB"]).read_text())
    options = dict(pairwise(arguments))
    name, seed = Path(options["--json"]).stem, int(options["--seed"])
    for seeds, error in json.loads(os.environ["CM_STAND_IN"]).get(name, ()):
        if seed in seeds:
            sys.exit(f"ERROR: {error}")
    fasm = next(word.removeprefix("fasm=") for word in arguments if word.startswith("fasm="))
    Path(fasm).write_text("")
    Path(options["--report"]).write_text(json.dumps({"detailed_net_timings": [], "fmax": {}}))
    cells = {"system.cm_clock_buffer": ["BUFGCTRL", f"X0Y{seed}/BUFG"]}
    Path(job["result"]).write_text(json.dumps({"cells": cells, "nets": {}}))


if __name__ == "__main__":
    {"yosys": yosys, "nextpnr": nextpnr}[sys.argv[1]](sys.argv[2:])
