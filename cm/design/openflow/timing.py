# SPDX-License-Identifier: Apache-2.0
"""Whether paths meet their clock: within each run by nextpnr's report, across anchors by the sum of both sides.

In each run the harness represents the other side, on its own clock. A path across an anchor is at most as long as
the longest path to the harness on one side plus the longest from it on the other; both include the anchor, so the
sum is on the safe side.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cm.design.openflow.netlists import HARNESS

_CLOCK = "cm_toggle_clock"


@dataclass(frozen=True, slots=True)
class Timing:
    """Delays in ns of one run: the longest path on its clock, to the harness, from it, and from it to it."""

    inside: float
    leaving: float
    arriving: float
    through: float


def read_timing(path: Path) -> Timing:
    """Read nextpnr's report. Raises OSError, ValueError."""
    report = json.loads(path.read_text(encoding="utf-8"))
    longest = {(False, False): 0.0, (False, True): 0.0, (True, False): 0.0, (True, True): 0.0}
    for net in report["detailed_net_timings"]:
        for end in net["endpoints"]:
            if not _counts(net, end):
                continue
            way = _CLOCK in net["event"], _CLOCK in end["event"]
            longest[way] = max(longest[way], end["delay"][-1])
    rates = [entry["achieved"] for name, entry in report["fmax"].items() if _CLOCK not in name]
    return Timing(1000 / min(rates) if rates else 0.0, longest[False, True], longest[True, False], longest[True, True])


def slacks(static: Timing, module: Timing, period: float) -> dict[str, float]:
    """Return the slack in ns of each kind of path at this period (ns); a negative one is a violation."""
    found = {
        "static part": static.inside,
        "module": module.inside,
        "static part to module": static.leaving + module.arriving,
        "module to static part": module.leaving + static.arriving,
    }
    if module.through:
        found["static part through module"] = static.leaving + module.through + static.arriving
    if static.through:
        found["module through static part"] = module.leaving + static.through + module.arriving
    if module.through and static.through:
        found["through both"] = static.leaving + module.through + static.through + module.arriving
    return {what: period - delay for what, delay in found.items()}


def _counts(net: dict[str, Any], end: dict[str, Any]) -> bool:
    """Whether a path counts: not the harness's own clock divider, nor a path without a clock on either side."""
    if "async" in net["event"] or "async" in end["event"]:
        return False
    own = end["cell"].rpartition(".")[2]
    return not (own.startswith(HARNESS) and ("_toggle" in own or "_spine" in own))
