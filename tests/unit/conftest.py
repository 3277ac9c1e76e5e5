# SPDX-License-Identifier: Apache-2.0
"""The board that tests of changes share; a module with another board overrides these fixtures."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from manager_schemas import written

from cm.schema.model import Config
from cm.simulation.software import Board as SimBoard


@pytest.fixture(scope="module")
def configs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Config]:
    """All of `manager_schemas`, from files."""
    return written(tmp_path_factory.mktemp("configs"))


@pytest.fixture(scope="module")
def sim(configs: dict[str, Config]) -> Iterator[SimBoard]:
    """A simulated board for them, whose ports take no time."""
    folder = next(iter(configs.values())).source
    assert folder is not None
    with SimBoard([folder.parent], arguments=["--icap-rate", "0", "--pcap-rate", "0"]) as board:
        yield board


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 1 MiB."""
    place = tmp_path / "disk"
    place.mkdir()
    made = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", place], capture_output=True, check=False)
    if made.returncode:
        pytest.skip(f"needs to mount a tmpfs: {made.stderr.decode().strip()}")
    yield place
    subprocess.run(["umount", place], check=True)
