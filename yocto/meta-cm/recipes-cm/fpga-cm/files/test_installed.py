# SPDX-License-Identifier: MIT
"""The installed package on this machine: its compiled module, its checks, and a manager on a simulated board."""

import json
import select
import subprocess
import sys
from pathlib import Path

import pytest

import cm

CAMERA = Path(cm.__file__).parent / "data/camera/camera.yaml"


@pytest.fixture
def runtime(tmp_path):
    """The folder of a manager on a simulated board, with the camera example loaded."""
    command = ["cm", "serve", "--sim", "--runtime-dir", str(tmp_path / "run")]
    with subprocess.Popen(command, stderr=subprocess.PIPE) as process:
        try:
            ready, _, _ = select.select([process.stderr], [], [], 120)
            assert ready, "the manager said nothing for two minutes"
            assert b"ready at" in process.stderr.readline()
            yield tmp_path / "run"
        finally:
            process.terminate()


def test_the_compiled_module_is_for_this_machine():
    from cm.device.native import _cm

    assert _cm.ffi


def test_the_camera_example_is_good():
    done = subprocess.run(["cm", "check", "--json", str(CAMERA)], capture_output=True, check=True)
    assert json.loads(done.stdout)["good"]


def test_a_manager_changes_mode_and_streams(runtime):
    with cm.connect(runtime_dir=runtime, timeout=60) as board:
        board.load("camera", mode="edge_detection")
        assert board.status.mode == "edge_detection"
        with board.stream("camera") as frames:
            assert next(iter(frames)).shape


if __name__ == "__main__":
    sys.exit(pytest.main([__file__]))
