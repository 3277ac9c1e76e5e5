# SPDX-License-Identifier: Apache-2.0
"""The board is the one that was asked for."""

from __future__ import annotations

import importlib
import os
from pathlib import Path

import capabilities
import pytest


@pytest.mark.parametrize("capability", sorted(capabilities.EXPECTED))
def test_promised_capability_is_there(capability: str) -> None:
    assert capabilities.LOOK[capability]()


@pytest.mark.parametrize("package", ["yaml", "numpy", "zmq", "google.protobuf", "_cffi_backend", "fastjsonschema"])
def test_dependency_is_installed(package: str) -> None:
    importlib.import_module(package)


@pytest.mark.needs("cm")
def test_compiled_module_loads() -> None:
    assert importlib.import_module("cm.device.native._cm").lib is not None


def test_two_processors_run() -> None:
    assert os.cpu_count() == 2


def test_nothing_of_the_host_is_mounted() -> None:
    assert "9p" not in Path("/proc/mounts").read_text()
