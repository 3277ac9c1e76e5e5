# SPDX-License-Identifier: Apache-2.0
"""No route grows unseen: calls and system calls of each, which do not depend on the machine, beside recorded ones.

Run as a script, it records what it counts for this version of Python in `counts.json`, and
in `BASE` the commit that was counted.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

import cm
from cm.tools.bench import compare, routes
from cm.wire import topics

HERE = Path(__file__).parent
RECORDED, BASE = HERE / "counts.json", HERE / "BASE"
PAGE = HERE.parents[1] / "docs/performance.md"
PYTHON = ".".join(map(str, sys.version_info[:2]))
GROWTH = 1.03
# A change of mode looks after its timers as often as the machine gives it time, and a thread of libzmq that is still
# awake needs no call to wake it: one commit counted 64 to 69 calls for a status.
TIMED = {
    "mode, calls of the manager": 1.10,
    **dict.fromkeys(("request, system calls", "write, system calls", "status, system calls"), 1.15),
}
WHY = """
If that is wanted: commit, run tests/bench/test_counts.py, and say why under "Counts" of docs/performance.md, which
names the commit of tests/bench/BASE. `make bench-compare` measures both trees in turns.
"""

pytestmark = pytest.mark.timeout(600)


def recorded() -> dict[str, dict[str, float]]:
    """The counts of each version of Python."""
    found: dict[str, dict[str, float]] = json.loads(RECORDED.read_text(encoding="utf-8"))
    return found


def allowed(name: str) -> float:
    """How many times as much a route may cost."""
    return TIMED.get(name, GROWTH)


@pytest.mark.skipif(not routes.may_trace(), reason="needs strace, and root or a kernel.yama.ptrace_scope of 0")
@pytest.mark.skipif(PYTHON not in recorded(), reason=f"counts are recorded for Python {', '.join(recorded())}")
def test_no_route_costs_more_than_is_recorded() -> None:
    before, now = recorded()[PYTHON], compare.measured(Path(sys.executable), "counts")
    assert now.keys() == before.keys(), "other routes or figures than recorded: run this file as a script"
    grown = {name: f"{before[name]} -> {now[name]}" for name in now if now[name] > before[name] * allowed(name)}
    assert not grown, f"{grown}{WHY}"


def test_a_recorder_costs_a_write_two_publications_and_a_handful_of_calls(tmp_path: Path) -> None:
    """What a client is told of a write is made once; who asked, and in what words, is kept from the write before."""
    many, wanted = 200, (topics.STATUS, topics.READ_REG, topics.IRQ, topics.AUDIT)  # as `cm record` subscribes
    counts = routes.Counts.made(tmp_path / "manager")
    words = (sys.executable, routes.__file__, "serve", str(tmp_path / "manager"))
    with routes.manager(tmp_path, *words), cm.connect(str(tmp_path)) as board, cm.connect(str(tmp_path)) as recorder:
        board.load("camera", mode="default")

        def calls() -> float:
            before = counts[routes.CALLS]
            for number in range(many):
                board.registers["led"] = number & 3
            return (counts[routes.CALLS] - before) / many

        calls()
        alone = min(calls() for _ in range(3))
        subscription = recorder.subscribe(*wanted, depth=10 * many)
        assert subscription.receive(60.0)  # the status: from here on nothing is missed
        calls()
        beside = min(calls() for _ in range(3))
        told = [subscription.receive(60.0) for _ in range(4 * many * 2)]
        subscription.close()
    kinds = [bytes(frames[0]) for frames in told if frames]
    assert {kind: kinds.count(kind) for kind in set(kinds)} == {topics.READ_REG: 4 * many, topics.AUDIT: 4 * many}
    assert beside - alone < 24, (alone, beside)  # a timer of the manager counts too


def test_the_page_names_the_commit_that_was_counted() -> None:
    assert BASE.read_text(encoding="ascii").strip()[:8] in PAGE.read_text(encoding="utf-8")


if __name__ == "__main__":
    counts = {**recorded(), PYTHON: compare.measured(Path(sys.executable), "counts")}
    RECORDED.write_text(json.dumps(counts, indent=2) + "\n", encoding="utf-8")
    commit = subprocess.run(["git", "rev-parse", "HEAD"], cwd=HERE, check=True, capture_output=True, text=True).stdout
    BASE.write_text(commit, encoding="ascii")
