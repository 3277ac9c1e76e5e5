# SPDX-License-Identifier: Apache-2.0
"""The wheels of other architectures do what they are for, under QEMU's user-mode emulation."""

from __future__ import annotations

import platform
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import foreign
import pytest

import cm
from cm.errors import CmError

RELEASE = Path(__file__).resolve().parents[2] / "build/release"
PATIENCE_S = 300.0  # before something is called hung


def _wheel(machine: str) -> Path | None:
    return next(iter(RELEASE.glob(f"*_{machine}.whl")), None)


def _built() -> list[str]:
    """Machines whose wheel is in build/release, for which `ARCHES=` asked; all of them, if none is there."""
    return sorted(filter(_wheel, foreign.ARCHES)) or sorted(foreign.ARCHES)


@pytest.fixture(scope="module", params=_built())
def python(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> foreign.Python:
    machine: str = request.param
    wheel = _wheel(machine)
    if wheel is None:
        pytest.skip(f"no wheel of {machine} in build/release: `make wheel` writes it")
    if foreign.emulator(machine) is None:
        pytest.skip(f"needs {foreign.EMULATORS[machine]} (Debian: qemu-user)")
    return foreign.python(machine, wheel, tmp_path_factory.mktemp(machine))


@pytest.fixture
def served(python: foreign.Python, tmp_path: Path) -> Iterator[Path]:
    """The runtime folder of `cm serve --sim`, run by the wheel."""
    log, folder = tmp_path / "log", tmp_path / "run"
    command = [python.script, "-m", "cm", "serve", "--sim", "--runtime-dir", folder, "--state-dir", tmp_path / "state"]
    with log.open("wb") as stream, subprocess.Popen(command, stdout=stream, stderr=stream) as manager:
        try:
            deadline = time.monotonic() + PATIENCE_S
            while b"ready at" not in log.read_bytes():
                assert manager.poll() is None, log.read_text()
                assert time.monotonic() < deadline, log.read_text()
                time.sleep(0.1)
            yield folder
        finally:
            manager.terminate()
            manager.wait(PATIENCE_S)


@pytest.mark.timeout(2 * PATIENCE_S)
def test_its_compiled_module_is_imported(python: foreign.Python) -> None:
    program = "import cm.device.native._cm as m, platform; print(m.__file__, platform.machine())"
    file, machine = python.run("-c", program).split()
    assert file.endswith("/wheel/cm/device/native/_cm.abi3.so")
    assert machine != platform.machine()


@pytest.mark.timeout(3 * PATIENCE_S)
def test_its_manager_serves_a_simulated_board(served: Path) -> None:
    """The client is of this machine's architecture: what is shared is the wire."""
    with cm.connect(runtime_dir=served, timeout=PATIENCE_S) as board:
        board.load("camera", "default")
        board.registers["focus"] = 2
        assert (board.mode, board.registers["focus"]) == ("default", 2)
        with pytest.raises(CmError, match="sharpen"):
            board.mode = "sharpen"
