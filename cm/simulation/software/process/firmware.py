# SPDX-License-Identifier: Apache-2.0
"""Bitstreams and overlays that a schema names and that are not built yet: assembled for the board."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from cm.formats import fdt
from cm.formats.bitstream.assemble import FrameRun, assemble
from cm.formats.bitstream.container import to_dma_words
from cm.formats.bitstream.geometry import FrameAddress
from cm.formats.bitstream.simulated_module import assemble_module
from cm.schema.model import Config, ConfigType, LoaderKind, Module, Overlay
from cm.schema.named_files import FileMissing, bitstream_path, overlay_path
from cm.simulation.software.hardware.board_spec import BoardSpec, ModuleSpec
from cm.simulation.software.hardware.configuration_memory import digest
from cm.simulation.software.transport.root import Root

_log = logging.getLogger(__name__)
_COLUMN_BYTES = 16 * 1024  # roughly a column of frames
_STATIC_FRAMES = 256
_STATIC_ROW = 31  # contains no region of ours


class Firmware:
    """The folder lib/firmware/cm/<config> of each configuration."""

    def __init__(self, root: Root, spec: BoardSpec) -> None:
        self._root, self._spec = root, spec

    def install(self) -> dict[str, ModuleSpec]:
        """Write what is missing; existing bitstreams are returned by `digest`, so that the port recognises them."""
        known: dict[str, ModuleSpec] = {}
        for config in self._spec.configs:
            for module in config.modules.values():
                path = self._module(config, module)
                if path is not None:
                    known.update(self._recognise(path, config, module))
            if config.type is ConfigType.FULL:
                self._static(config)
            for overlay in _overlays(config):
                self._overlay(config, overlay)
        return known

    def images(self) -> dict[str, Config]:
        """The full configurations that describe their blocks, by the digest of their images."""
        found: dict[str, Config] = {}
        for config in self._spec.configs:
            path = (
                self._found(bitstream_path, config, None) if config.blocks and config.type is ConfigType.FULL else None
            )
            if path is not None:
                found[digest(to_dma_words(path))] = config
        return found

    def _module(self, config: Config, module: Module) -> Path | None:
        """The path of the module's bitstream; None if there was none and it was made."""
        found = self._found(bitstream_path, config, module)
        data = self._assembled(module) if found is None else found.read_bytes()
        if found is None:
            self._write_bitstream(config, module.bitstream, module.name, data)
        region = config.regions.get(module.region)
        if region is not None and region.loader is LoaderKind.OVERLAY:
            self._loading_overlay(config, module, data)
        return found

    def _assembled(self, module: Module) -> bytes:
        region = self._spec.regions.get(module.region)
        footprint = region.footprint if region else ()
        columns = sum(frames.column_last - frames.column_first + 1 for frames in footprint)
        size = columns * _COLUMN_BYTES
        return assemble_module(
            module.name, model=module.model, device=self._spec.device, footprint=footprint, size=size
        )

    def _loading_overlay(self, config: Config, module: Module, data: bytes) -> None:
        """What the kernel needs to load through an fpga-region: a .bin, and an overlay that names it."""
        if self._found(overlay_path, config, module.name) is None:
            binary = f"{module.name}.bin"
            self._write(config, binary, to_dma_words(data))
            properties = {"firmware-name": f"cm/{config.name}/{binary}\0".encode(), "partial-fpga-config": b""}
            tree = fdt.overlay(f"/fpga-region-{module.region}", fdt.FdtNode("", properties))
            self._write(config, f"{module.name}.dtbo", fdt.pack(tree))

    def _static(self, config: Config) -> None:
        if self._found(bitstream_path, config, None) is None:
            frames = bytes(4 * self._spec.device.family.frame_words * _STATIC_FRAMES)
            run = FrameRun(FrameAddress(0, _STATIC_ROW, 0), frames)
            data = assemble(self._spec.device, [run], design=config.name, partial=False)
            self._write_bitstream(config, config.bitstream, config.name, data)

    def _overlay(self, config: Config, overlay: Overlay) -> None:
        if self._found(overlay_path, config, overlay) is None:
            name = overlay.file.name if overlay.file else f"{overlay.name}.dtbo"
            self._write(config, name, _node_overlay(overlay.name))

    def _recognise(self, path: Path, config: Config, module: Module) -> Iterator[tuple[str, ModuleSpec]]:
        spec = next(s for s in self._spec.modules if (s.config, s.name) == (config.name, module.name))
        try:
            yield digest(to_dma_words(path)), spec
        except (OSError, ValueError) as error:
            _log.warning("%s is not readable as a bitstream: %s", path, error)

    def _found(self, path: Callable[[Config, Any, Path], Path], config: Config, what: object) -> Path | None:
        try:
            return path(config, what, self._root.path)
        except FileMissing:
            return None

    def _write_bitstream(self, config: Config, stated: Path | None, name: str, data: bytes) -> None:
        if stated:
            _log.warning("configuration %s: no file %s: one that only this board takes is made", config.name, stated)
        file = stated.name if stated else f"{name}.bit"
        self._write(config, file, to_dma_words(data) if file.endswith(".bin") else data)

    def _write(self, config: Config, name: str, data: bytes) -> None:
        self._root.write(f"lib/firmware/cm/{config.name}/{name}", data)


def _overlays(config: Config) -> Iterator[Overlay]:
    yield from config.overlays
    for mode in config.modes.values():
        yield from mode.overlays


def _node_overlay(name: str) -> bytes:
    """An overlay that adds one node, and loads nothing: bitstreams go through ICAP."""
    node = fdt.FdtNode(name, {"compatible": b"cm,sim-overlay\0", "status": b"okay\0"})
    return fdt.pack(fdt.overlay("/", fdt.FdtNode("", {}, [node])))
