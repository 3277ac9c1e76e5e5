# SPDX-License-Identifier: Apache-2.0
"""Child processes run this package, whatever is in the current folder."""

from __future__ import annotations

import os
import site
import subprocess
import sys
from pathlib import Path

import pytest

from cm import child

HOSTILE = "import os; os.write(2, b'hostile\\n'); os._exit(66)\n"


@pytest.fixture
def trap(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The current folder, with modules named like this package and those that it imports."""
    (tmp_path / "cm").mkdir()
    for name in ("cm/__init__.py", "yaml.py", "runpy.py", "json.py", "zmq.py", "numpy.py", "argparse.py"):
        (tmp_path / name).write_text(HOSTILE)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(command: list[str], **environment: str) -> subprocess.CompletedProcess[str]:
    env = {**child.environment(), **environment}
    return subprocess.run(command, env=env, capture_output=True, text=True, timeout=60, check=False)


def test_the_trap_catches_python_m(trap: Path) -> None:
    assert run([sys.executable, "-m", "cm.simulation.software", "--help"]).returncode == 66


@pytest.mark.parametrize("safe_path", ["", "1"])
def test_a_child_runs_ours(trap: Path, safe_path: str) -> None:
    done = run(child.command("cm.cli.main", "--version"), PYTHONSAFEPATH=safe_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("cm ")


def test_a_manager_and_its_simulated_board_start_in_any_folder(trap: Path, tmp_path_factory) -> None:
    runtime = tmp_path_factory.mktemp("run")
    command = child.command("cm", "serve", "--sim", "--runtime-dir", str(runtime), "--state-dir", str(runtime / "s"))
    process = subprocess.Popen(command, env=child.environment(), stderr=subprocess.PIPE, text=True)
    try:
        said = [next(line for line in process.stderr if "ready at" in line or "hostile" in line)]
    finally:
        process.terminate()
        said.append(process.communicate()[1])
    assert "hostile" not in "".join(said)
    assert process.returncode == 0


def test_pythonpath_is_honoured(trap: Path, tmp_path_factory) -> None:
    folder = tmp_path_factory.mktemp("path")
    (folder / "of_the_user.py").write_text("import sys; print(sys.argv, __name__)\n")
    done = run(child.command("of_the_user", "a", "b c"), PYTHONPATH=str(folder))
    assert done.stdout == f"[{str(folder / 'of_the_user.py')!r}, 'a', 'b c'] __main__\n"


def test_an_installed_package_is_not_put_before_the_standard_library(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(child, "__file__", str(Path(site.getsitepackages()[0]) / "cm" / "child.py"))
    assert child.environment() == dict(os.environ)


def test_a_work_tree_goes_before_what_the_user_has_on_the_path(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(child, "__file__", "/tree/cm/child.py")
    monkeypatch.setenv("PYTHONPATH", f"/mine{os.pathsep}")
    assert child.environment()["PYTHONPATH"] == f"/tree{os.pathsep}/mine"
