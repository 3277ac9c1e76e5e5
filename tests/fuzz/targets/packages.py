# SPDX-License-Identifier: Apache-2.0
"""shell.json and accel.json of dfx-mgr's packages: runtime schemas, or ImportRefused."""

from __future__ import annotations

import json
import tempfile
from contextlib import suppress
from pathlib import Path

from pieces import join, split

from cm.formats.bitstream import FrameAddress, FrameRun, assemble
from cm.formats.importers.dfx_mgr import import_dfx_mgr
from cm.formats.importers.result import ImportRefused
from cm.schema import SchemaError, dump, loads

PACKAGES = ("cm.formats.importers",)
MAX_LENGTH = 8192

_FOLDER = tempfile.TemporaryDirectory(prefix="cm-fuzz-")


def _base() -> Path:
    base = Path(_FOLDER.name, "base")
    slot = base / "edge" / "edge_slot0"
    slot.mkdir(parents=True)
    image = assemble("xck26", [FrameRun(FrameAddress(0, 0, 26), bytes(372))], partial=True)
    (slot / "edge.bit").write_bytes(image)
    return base


_BASE = _base()


def seeds() -> list[bytes]:
    shell = {
        "shell_type": "PL_DFX",
        "num_slots": 2,
        "uid": "12",
        "isolation_slots": [{"isolation": "0xA0", "decouple": ["0x80010000", "0x80020000"]}],
    }
    accel = {"accel_type": "SIHA_PL_DFX", "uid": 13, "pid": 12, "accel_devices": [{"dev_name": "20100000.accel"}]}
    flat = {"shell_type": "XRT_FLAT", "num_pl_slots": "1"}
    return [join(json.dumps(part).encode() for part in parts) for parts in ((shell, accel), (flat, accel))]


def one(data: bytes) -> None:
    shell, accel = [*split(data), b"", b""][:2]
    (_BASE / "shell.json").write_bytes(shell)
    (_BASE / "edge" / "edge_slot0" / "accel.json").write_bytes(accel)
    with suppress(ImportRefused, SchemaError):
        for config in import_dfx_mgr(_BASE).configs:
            loads(dump(config))
