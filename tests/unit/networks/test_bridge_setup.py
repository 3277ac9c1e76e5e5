# SPDX-License-Identifier: Apache-2.0
"""What a bridge needs before it can start is reported at once, with a distinct exit status."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from cm import child
from cm.cli.bridge_fleet import _name
from cm.errors import InvalidRequest

_WITHOUT = "import sys; sys.modules[sys.argv[1]] = None; from cm.cli.main import main; sys.exit(main(sys.argv[2:]))"


@pytest.mark.parametrize(("network", "library"), [("ros", "zenoh"), ("ros", "xxhash"), ("fleet", "zenoh")])
def test_a_library_that_is_missing_is_named_and_the_unit_does_not_try_again(network: str, library: str) -> None:
    command = [sys.executable, "-c", _WITHOUT, library, "bridge", network]
    done = subprocess.run(command, env=child.environment(), capture_output=True, text=True, check=False, timeout=60)
    assert (done.returncode, "pip install 'eclipse-zenoh>=" in done.stderr) == (78, True), done.stderr
    unit = Path(__file__).parents[3] / "system/systemd/cm-bridge@.service"
    assert "\nRestartPreventExitStatus=2 78\n" in unit.read_text()


def test_a_boards_name_is_that_in_its_certificate_and_another_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("zenoh")
    file = tmp_path / "b1.json5"
    file.write_text(json.dumps({"metadata": {"name": "b1", "kind": "board"}}))
    assert (_name("", file), _name("b1", file), _name("b2", None), _name("", None)) == ("b1", "b1", "b2", "")
    with pytest.raises(InvalidRequest, match=r"'b1'.*cm fleet keys DIR board b2"):
        _name("b2", file)
