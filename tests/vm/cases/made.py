# SPDX-License-Identifier: Apache-2.0
"""A design that `cm build generate` made, on this board: its hardware modelled, its files where a user has them."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import yaml

from cm import device
from cm.formats.bitstream import Container, assemble_module, convert

DESIGNS = Path("/opt/cm/designs")
FIRMWARE = Path("/lib/firmware/cm")
CONTROL_ID, STATIC_IDENTITY, REGION_IDENTITY = 0x00, 0x1C, 0x10C  # of cm_control.v


@dataclass(frozen=True)
class Design:
    """A generated design in a folder of its own, with bitstreams for its modules."""

    folder: Path

    @property
    def schema(self) -> Path:
        return next(self.folder.glob("*.yaml"))

    @property
    def config(self) -> dict:
        return yaml.safe_load(self.schema.read_text())["config"]

    @property
    def control(self) -> int:
        """Address of its control registers."""
        return self.config["static"]["base_address"]

    @property
    def static(self) -> str:
        """Name of the static part's overlay."""
        return f"{self.config['name']}_static"

    def overlay(self, name: str) -> bytes:
        return (self.folder / f"{name}.dtbo").read_bytes()

    def identity(self, module: str) -> int:
        return self.config["modules"][module]["identity"]

    def write_bitstreams(self) -> None:
        """As `cm build collect` brings them from Vivado: .bin files for the device."""
        config = self.config
        for name, module in config["modules"].items():
            bit = assemble_module(name, device=config["device"], size=16 * 1024)
            (self.folder / module["bitstream"]).write_bytes(convert(bit, Container.BIN_SWAPPED))

    def power_up(self) -> None:
        """What the static part's read-only registers say; they are memory here, and there is a window to them."""
        with device.Uio.open(self.control) as window:
            window.write(CONTROL_ID, 0x434D3031)
            window.write(STATIC_IDENTITY, self.config["static"]["identity"])
            window.write(REGION_IDENTITY, 0)


@contextmanager
def design(name: str) -> Iterator[Design]:
    """A design whose hardware is there; nothing of it has been applied yet."""
    made = Design(FIRMWARE / name)
    shutil.rmtree(made.folder, ignore_errors=True)
    shutil.copytree(DESIGNS / name, made.folder)
    made.write_bitstreams()
    overlays = device.Overlays("/")
    overlays.apply("hardware", made.overlay("hardware"))
    try:
        yield made
    finally:
        for overlay in reversed(overlays.list()):
            overlays.remove(overlay)
