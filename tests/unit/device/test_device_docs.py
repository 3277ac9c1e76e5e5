# SPDX-License-Identifier: Apache-2.0
"""The example of docs/device.md runs as it is printed."""

from __future__ import annotations

import textwrap
from pathlib import Path

import pytest

from cm.simulation.software import Board

ROOT = Path(__file__).parents[3]


def example() -> str:
    """Return the first indented block that imports cm.device."""
    text = (ROOT / "docs/device.md").read_text()
    block = text[text.index("    import cm.device as device") : text.index("\n## What there is")]
    return textwrap.dedent(block)


def test_the_example_runs(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    with Board([ROOT / "cm/data/camera/camera.yaml"]) as board:
        monkeypatch.setenv("CM_ROOT", str(board.root))
        source = example().replace("/tmp/board", str(board.root))
        exec(compile(source, "docs/device.md", "exec"), {})
    printed = capsys.readouterr().out.splitlines()
    assert "0xc0ffee" in printed
    assert printed[-1] == "loaded"
