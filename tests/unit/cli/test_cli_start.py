# SPDX-License-Identifier: Apache-2.0
"""What short commands import: most of their time is spent on importing modules."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator

import pytest
from daemon_thread import Daemon, daemon

# Each of them takes as long as a manager takes for a hundred requests, or longer.
HEAVY = {"numpy", "asyncio", "ssl", "hashlib", "yaml", "fastjsonschema", "cffi", "cm.client.stream", "cm.schema.loader"}


@pytest.fixture(scope="module")
def camera() -> Iterator[Daemon]:
    with daemon(load="camera/default") as made:
        made.load("default")
        yield made


@pytest.mark.parametrize(
    "words",
    [
        ["status"],
        ["status", "--json"],
        ["configs"],
        ["mode", "default"],
        ["plan", "edge_detection"],
        ["reg", "list"],
        ["reg", "read", "focus"],
        ["reg", "write", "focus=1"],
        ["stream", "list"],
        ["lease", "list"],
    ],
    ids=" ".join,
)
def test_a_command_that_asks_and_prints_imports_little(camera: Daemon, words: list[str]) -> None:
    command = [sys.executable, "-X", "importtime", "-m", "cm", *words, "--runtime-dir", str(camera.folder / "run")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    imported = {line.rpartition("|")[2].strip() for line in done.stderr.splitlines() if line.startswith("import time:")}
    assert done.returncode == 0, done.stderr[-500:]
    assert "cm.client.board" in imported
    assert imported & HEAVY == set()


def test_an_action_of_build_imports_no_other_action() -> None:
    program = "import sys; from cm.cli.main import main; main(['build', 'check', 'none.yaml']); print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120, check=False)
    assert "none.yaml:1:1: cannot be read" in done.stderr
    imported = {name for name in done.stdout.split() if name.startswith("cm.")}
    assert {name for name in imported if name.startswith("cm.cli.build_")} == {"cm.cli.build_check"}
    rooms = ("cm.design.collect", "cm.design.generate", "cm.design.openflow", "cm.design.partition", "cm.design.run.")
    assert {name for name in imported if name.startswith(rooms)} == set()
