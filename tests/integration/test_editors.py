# SPDX-License-Identifier: Apache-2.0
"""What an editor knows about the package: mypy and pyright resolve an install, and its types are useful."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest
from manager_process import REPOSITORY

pytestmark = pytest.mark.programs
PROGRAM = """\
import asyncio

import cm
import cm.aio
from cm.client.frame import Frame
from cm.device import Uio
from cm.wire.messages.status import Irq, PlanInfo, Status


class Level:
    def __index__(self) -> int:  # as numpy's integers have
        return 2


with cm.connect("tcp://kria.local", timeout=3.0) as board:
    status: Status = board.status
    plan: PlanInfo = board.plan("edge")
    seconds: float = board.load("camera", progress=lambda p: print(p.fraction))
    board.mode = "edge"
    focus: int = board.registers["focus"]
    board.registers["focus"] = Level()
    board.registers.write({"focus": 2, "led.blink": "fast"})
    irq: Irq = board.interrupts["done"].wait(timeout=1.0)
    for frame in board.stream("camera"):
        picture: Frame = frame
        print(frame.info.sequence, frame.mean())


async def main() -> Status:
    async with cm.aio.connect() as other:
        return await other.status()


asyncio.run(main())
with Uio.open("static") as window:
    value: int = window.read(0x10)
"""
MISTAKES = """\
other = cm.connect()
other.moed = "edge"
other.load(3)
other.status.mode.nothing
cm.connect(time_out=3.0)
cm.conect()
"""


@pytest.fixture(params=["editable", "wheel"])
def python(request: pytest.FixtureRequest, installed: Path, tmp_path: Path) -> Path:
    """An interpreter with the package installed in this way."""
    if request.param == "editable":
        return Path(sys.executable)
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", tmp_path / "venv"], check=True)
    python = tmp_path / "venv/bin/python"
    ask = "import sysconfig; print(sysconfig.get_path('purelib'))"
    site = Path(subprocess.run([python, "-c", ask], capture_output=True, text=True, check=True).stdout.strip())
    for part in installed.iterdir():
        (site / part.name).symlink_to(part)
    (site / "others.pth").write_text(f"{sysconfig.get_path('purelib')}\n")
    return python


def by_mypy(python: Path, program: Path) -> set[int]:
    """The lines in which it reports mistakes."""
    pytest.importorskip("mypy", reason="needs mypy: make lint installs it")
    cache = REPOSITORY / ".mypy_cache/editors"
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", "--cache-dir", cache, "--python-executable", python, program.name],
        cwd=program.parent,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode in (0, 1), done.stdout + done.stderr
    return {int(line) for line in re.findall(rf"^{program.name}:(\d+): error", done.stdout, re.MULTILINE)}


def by_pyright(python: Path, program: Path) -> set[int]:
    """The lines in which it reports mistakes."""
    command = [Path(sys.executable).parent / "pyright"]
    if not command[0].exists():
        pytest.skip("needs pyright: make lint installs it")
    asked = subprocess.run([*command, "--version"], capture_output=True, text=True, check=False)
    if asked.returncode != 0 or "pyright" not in asked.stdout:
        pytest.skip("needs_pyright: its program comes from the npm registry, which cannot be reached")
    done = subprocess.run(
        [*command, "--outputjson", "--pythonpath", python, program.name],
        cwd=program.parent,
        capture_output=True,
        text=True,
        check=False,
    )
    found = json.loads(done.stdout)["generalDiagnostics"]
    return {entry["range"]["start"]["line"] + 1 for entry in found if entry["severity"] == "error"}


@pytest.mark.timeout(300)
@pytest.mark.parametrize("editor", [by_mypy, by_pyright])
def test_an_editor_resolves_the_package_and_tells_mistakes(editor: object, python: Path, tmp_path: Path) -> None:
    program = tmp_path / "program.py"
    program.write_text(PROGRAM + MISTAKES)
    assert callable(editor)
    first = PROGRAM.count("\n") + 1
    assert editor(python, program) == {first + number for number in range(1, 6)}
