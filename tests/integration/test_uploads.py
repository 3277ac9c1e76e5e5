# SPDX-License-Identifier: Apache-2.0
"""What is too long for one message is uploaded in parts; and what becomes of parts that nobody uses."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from manager_process import Manager, served

from cm.client.errors import RequestFailed

MIB = 1 << 20
SCHEMA = """
config:
  name: sent
  regions: [left]
  modules: {fir: {region: left}}
  mmio: [{base_address: 0x1000, registers: {led: {offset: 0x10}}}]
  modes: {default: {modules: [fir]}}
"""


@pytest.fixture(scope="module")
def manager() -> Iterator[Manager]:
    with served() as (made, _):
        with made.connected() as board:
            board.load("camera", "default")
        yield made


def test_files_longer_than_a_message_are_provisioned_whole(manager: Manager, tmp_path: Path) -> None:
    schema, image, overlay = (tmp_path / name for name in ("sent.yaml", "fir.bin", "fir.dtbo"))
    schema.write_text(SCHEMA, encoding="utf-8")
    data = np.random.default_rng(1).integers(0, 256, 20 * MIB, np.uint8).tobytes()
    image.write_bytes(data)
    overlay.write_bytes(b"overlay")
    with manager.connected() as board:
        assert board.provision(schema, image, overlay).name == "sent"
        assert all(client.upload_bytes == 0 for client in board.clients())
    (stored,) = manager.runtime.parent.glob("state/configs/sent/fir.bin")
    assert hashlib.sha256(stored.read_bytes()).digest() == hashlib.sha256(data).digest()


def test_a_frame_longer_than_a_message_is_written(manager: Manager) -> None:
    frame = np.arange(10 * MIB, dtype=np.uint8)
    with manager.connected() as board:
        with pytest.raises(RequestFailed, match=f"{10 * MIB}"):  # it came whole: the stream's frames are shorter
            board.write("to_pl", frame)
        assert all(client.upload_bytes == 0 for client in board.clients())
