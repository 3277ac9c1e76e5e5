# SPDX-License-Identifier: Apache-2.0
"""Bitstreams and overlays that a schema names and nobody has built yet: assembled for the board."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from pathlib import Path

from cm.bitstream.assemble import FrameRun, assemble
from cm.bitstream.convert import to_dma_words
from cm.bitstream.far import FrameAddress
from cm.bitstream.module import assemble_module
from cm.schema.model import Config, Module, Overlay

from . import fdt
from .board import BoardSpec, ModuleSpec
from .configmem import digest
from .root import Root

_log = logging.getLogger(__name__)
_COLUMN_BYTES = 16 * 1024  # about a column of frames
_STATIC_FRAMES = 256
_STATIC_ROW = 31
_SUFFIXES = (".bit", ".bin", ".bit.bin")


class Firmware:
    """The folder lib/firmware/cm/<config> of each configuration."""

    def __init__(self, root: Root, spec: BoardSpec, size: int | None) -> None:
        """`size`: bytes of frame data in a module's bitstream; None: as many as its region holds."""
        self._root, self._spec, self._size = root, spec, size

    def install(self) -> dict[str, ModuleSpec]:
        """Write what is missing; what is there already is returned by `digest`, for the port to know."""
        known: dict[str, ModuleSpec] = {}
        for config in self._spec.configs:
            for module in config.modules.values():
                path = _find(config, module.bitstream, module.name, _SUFFIXES)
                if path is None:
                    self._write_module(config, module)
                else:
                    known.update(self._recognise(path, config, module))
            if config.bitstream is not None and _find(config, config.bitstream, "", ()) is None:
                self._write(config, config.bitstream.name, self._full(config))
            for overlay in _overlays(config):
                if _find(config, overlay.file, overlay.name, (".dtbo",)) is None:
                    name = overlay.file.name if overlay.file else f"{overlay.name}.dtbo"
                    self._write(config, name, _overlay_blob(overlay.name))
        return known

    def _write(self, config: Config, name: str, data: bytes) -> None:
        self._root.write(f"lib/firmware/cm/{config.name}/{name}", data)

    def _write_module(self, config: Config, module: Module) -> None:
        region = self._spec.regions.get(module.region)
        footprint = region.footprint if region else ()
        columns = sum(frames.column_last - frames.column_first + 1 for frames in footprint)
        data = assemble_module(
            module.name,
            model=module.model,
            device=self._spec.device,
            footprint=footprint,
            size=self._size or columns * _COLUMN_BYTES,
        )
        name = module.bitstream.name if module.bitstream else f"{module.name}.bit"
        self._write(config, name, to_dma_words(data) if name.endswith(".bin") else data)

    def _full(self, config: Config) -> bytes:
        frames = bytes(4 * self._spec.device.family.frame_words * _STATIC_FRAMES)
        run = FrameRun(FrameAddress(0, _STATIC_ROW, 0), frames)
        data = assemble(self._spec.device, [run], design=config.name, partial=False)
        assert config.bitstream is not None
        return to_dma_words(data) if config.bitstream.name.endswith(".bin") else data

    def _recognise(self, path: Path, config: Config, module: Module) -> Iterator[tuple[str, ModuleSpec]]:
        spec = next(s for s in self._spec.modules if (s.config, s.name) == (config.name, module.name))
        try:
            yield digest(to_dma_words(path.read_bytes())), spec
        except (OSError, ValueError) as error:
            _log.warning("%s is not readable as a bitstream: %s", path, error)


def _find(config: Config, written: Path | None, name: str, suffixes: tuple[str, ...]) -> Path | None:
    """A file that stands beside the schema, by the manager's rule."""
    if config.source is None:
        return None
    folder = config.source.parent
    candidates = [folder / written] if written else [folder / (name + suffix) for suffix in suffixes]
    return next((path for path in candidates if path.is_file()), None)


def _overlays(config: Config) -> Iterator[Overlay]:
    yield from config.overlays
    for mode in config.modes.values():
        yield from mode.overlays


def _overlay_blob(name: str) -> bytes:
    """An overlay that adds one node, and loads nothing: bitstreams go through ICAP."""
    node = fdt.FdtNode(name, {"compatible": b"cm,sim-overlay\0", "status": b"okay\0"})
    return fdt.pack(fdt.overlay("/", fdt.FdtNode("__overlay__", {}, [node])))
