# SPDX-License-Identifier: Apache-2.0
"""Other people's PYNQ overlays, where a folder of fetched ones is given: ``OVERLAYS=FOLDER``."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from cm.formats import hwh
from cm.formats.importers import described_by, import_pynq
from cm.schema import dump, loads


@pytest.fixture(scope="module")
def pairs() -> list[Path]:
    folder = os.environ.get("OVERLAYS")
    if not folder:
        pytest.skip("OVERLAYS names no folder of .bit and .hwh pairs")
    found = [bit for bit in sorted(Path(folder).rglob("*.bit")) if described_by(bit).is_file()]
    if not found:
        pytest.skip(f"{folder} has no pair of a .bit and a .hwh")
    return found


def test_every_overlay_is_imported_and_holds_what_the_processor_reaches(pairs: list[Path]) -> None:
    wrong = []
    for bit in pairs:
        [config] = import_pynq(bit).configs
        there = hwh.windows(hwh.read(described_by(bit)))
        if loads(dump(config), Path("overlay.yaml")).blocks != config.blocks:
            wrong.append(f"{bit}: its blocks are others when they are read back")
        missing = {window.base for window in there} - {block.base_address for block in config.blocks.values()}
        if missing:
            wrong.append(f"{bit}: no block at {', '.join(map(hex, missing))}")
        if there and not (config.registers or config.memories or config.streams):
            wrong.append(f"{bit}: nothing of {len(there)} windows")
    assert wrong == []


def test_every_engine_and_interrupt_is_described_or_named(pairs: list[Path]) -> None:
    silent = []
    for bit in pairs:
        imported, design = import_pynq(bit), hwh.read(described_by(bit))
        [config] = imported.configs
        told = "\n".join(imported.notes)
        engines = {channel.instance for channel in hwh.dma_channels(design)}
        silent += [f"{bit}: {name}" for name in engines if name not in told]
        for line in hwh.interrupts(design):
            known = any(name.startswith(f"{line.instance}_{line.port}".lower()) for name in config.interrupts)
            if not (known or line.instance in told or line.instance in engines):
                silent.append(f"{bit}: interrupt {line.port} of {line.instance}")
    assert silent == []
