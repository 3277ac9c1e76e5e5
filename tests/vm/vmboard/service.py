# SPDX-License-Identifier: Apache-2.0
"""The board on which our packages are installed: tests on the host that use it as its owner would."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from pathlib import Path

from vmboard import installed, report
from vmboard.cache import Cache
from vmboard.debian import System
from vmboard.paths import REPOSITORY
from vmboard.qemu import Machine
from vmboard.tiers import Tier

TESTS = REPOSITORY / "tests/vm/service"


def machine(cache: Cache, tier: Tier, place: Path, forwards: dict[int, int]) -> Machine:
    """The board with a root disk of its own in `place`, and the artefacts on the other disk."""
    made, wheels = installed.prepared(cache, tier)
    place.mkdir(parents=True, exist_ok=True)
    installed.copy(made.root, place / "root.ext4")
    payload = installed.disk(installed.release(tier.arch, made), place, wheels)
    return installed.machine(cache, tier, System(made.kernel, place / "root.ext4"), payload, forwards)


def test(board: Machine, place: Path, keyword: str) -> report.Results:
    """Run the tests in tests/vm/service; they boot the board, more than once."""
    (place / "machine").write_bytes(pickle.dumps(board))
    environment = {**os.environ, "CM_VM_PLACE": str(place), "PYTHONPATH": str(REPOSITORY)}
    xml = place / "service.xml"
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-v",
        "-p",
        "no:cacheprovider",
        f"--junit-xml={xml}",
        "--durations=12",
        "--tb=short",
    ]
    command += ["--timeout", str(200 * board.slow), *(["-k", keyword] if keyword else []), str(TESTS)]
    with (place / "pytest.log").open("wb") as log:
        status = subprocess.run(command, env=environment, cwd=REPOSITORY, stdout=log, stderr=log, check=False)
    consoles = sorted(place.rglob("boot-*/console.log"))
    (place / "console.log").write_bytes(b"".join(path.read_bytes() for path in consoles))
    results = report.of_host(xml, place / "console.log", status.returncode)
    for image in place.rglob("*.ext4"):
        image.unlink()
    return results
