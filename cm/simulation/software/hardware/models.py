# SPDX-License-Identifier: Apache-2.0
"""What a module does to a frame, in numpy. Users add their own: see `Models.load`.

A model is a function ``model(frame, registers) -> result``: `frame` is a read-only (height, width)
array of bytes, `registers` maps the names of the module's registers to their present values, and
`result` is an array whose bytes leave the region. It must not keep `frame`. One with a state is a class,
`Model`: one object for each load of a module, with its registers, memories, streams and interrupts.
"""

from __future__ import annotations

import difflib
import importlib
import importlib.util
import logging
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, MutableMapping
from functools import cached_property
from pathlib import Path
from types import MappingProxyType, ModuleType
from typing import Any, ClassVar, Protocol, TypeAlias

from cm.schema.model import Block, Config
from cm.simulation.software.errors import SimError
from cm.wire.lazy_numpy import NDArray, np


class Registers(MutableMapping[str, int]):
    """The registers of a module by name: what is written here is read on the bus, and vice versa."""

    def __init__(self, cells: Mapping[str, Any]) -> None:
        self._cells = cells

    def __getitem__(self, name: str) -> int:
        return int(self._cells[name].value)

    def __setitem__(self, name: str, value: int) -> None:
        self._cells[name].value = value

    def __delitem__(self, name: str) -> None:
        raise TypeError("a register cannot be deleted")

    def __iter__(self) -> Iterator[str]:
        return iter(self._cells)

    def __len__(self) -> int:
        return len(self._cells)


class Surroundings(Protocol):
    """What a model may do to the board."""

    def interrupt(self, name: str) -> None:
        """Raise an interrupt of the schema. Raises SimError for an unknown one."""

    def memory(self, address: int, length: int) -> NDArray[Any]:
        """Bytes of main memory as a master in the PL has them. Raises SimError where none was allocated."""

    def send(self, stream: str, data: Any) -> bool:
        """Let a packet leave on a stream to memory; False if too many wait already, and it is lost."""

    def transfer(
        self, channel: str, address: int, length: int, done: Callable[[int, int], object]
    ) -> Callable[[], None]:
        """Move bytes of main memory to a channel's stream, or a packet into them; returns what cancels that.

        `done` gets how many were moved, and a negative errno or 0. Raises SimError where no memory was allocated,
        NodeError for no length, and while the engine moves something else.
        """

    def after(self, seconds: float, call: Callable[[], object]) -> None:
        """Do something later, unless another module has been loaded by then."""


class Model:
    """Base of models with a state. It is made when its module has been loaded, and forgotten with it.

    `registers` are those of the module, the configuration and the static part; `memories` are numpy arrays of the
    shape that the schema gives, over the bytes that the bus sees. `outputs` names the streams to memory that the
    model fills itself, by `board.send`: nothing else comes on them.
    """

    outputs: ClassVar[tuple[str, ...]] = ()
    reads: ClassVar[tuple[int, ...]] = ()  # offsets of a block's words that `read` answers
    name = ""  # of the block
    interrupts: tuple[str, ...] = ()  # of the block
    channels: Mapping[str, str] = MappingProxyType({})  # of the block, if it is a DMA engine, by direction
    words: NDArray[Any]  # 32 bits each, of the block's window, as the bus sees them

    def __init__(self, registers: Registers, memories: Mapping[str, NDArray[Any]], board: Surroundings) -> None:
        self.registers = registers
        self.memories = memories
        self.board = board
        self.start()

    @classmethod
    def of_block(cls, block: Block, words: NDArray[Any], channels: Mapping[str, str], *parts: Any) -> Model:
        """The model of a block, which has a name, words, channels and interrupts when it starts."""
        made = cls.__new__(cls)
        made.channels = channels
        made.name, made.words, made.interrupts = block.name, words, block.interrupts
        made.__init__(*parts)  # type: ignore[misc]
        return made

    def wrote(self, offset: int, value: int, before: int) -> None:
        """The bus has written a word of the block, described or not; `before`: what it held."""

    def read(self, offset: int) -> int:
        """What the bus reads at an offset that `reads` names."""
        return int(self.words[offset // 4])

    def start(self) -> None:
        """The module was loaded: registers are at their reset, memories zero."""

    def written(self, register: str, value: int) -> None:
        """The bus has written a register; `value` is what it holds now."""

    def frame(self, stream: str, frame: NDArray[Any]) -> NDArray[Any] | None:
        """A packet came in on the channel `stream`: (height, width) bytes, read-only.

        Returns what leaves; None: nothing.
        """
        del stream
        return frame

    def stop(self) -> None:
        """The module's region is about to be loaded anew."""


Frame: TypeAlias = "NDArray[np.uint8]"
Function = Callable[[Frame, Mapping[str, int]], Frame]
AnyModel = Function | type[Model]

ENTRY_POINTS = "cm.sim.models"
_log = logging.getLogger(__name__)
_LINES = 64  # of a picture worked on at a time, so that intermediate results stay in the cache


def default(frame: Frame, registers: Mapping[str, int]) -> Frame:  # noqa: ARG001 - a model's signature
    """The data as it is."""
    return frame


def edge(frame: Frame, registers: Mapping[str, int]) -> Frame:
    """3×3 Sobel magnitude |Gx| + |Gy|, saturated to 255; values below `threshold` and borders are 0."""
    result = np.zeros_like(frame)
    if frame.shape[0] < 3 or frame.shape[1] < 3:
        return result
    threshold = min(registers.get("threshold", 0), 256)
    for top in range(0, frame.shape[0] - 2, _LINES):
        magnitude = _sobel(frame[top : top + _LINES + 2].astype(np.int16))
        np.minimum(magnitude, 255, out=magnitude)
        if threshold > 0:
            magnitude *= magnitude >= threshold
        result[top + 1 : top + 1 + len(magnitude), 1:-1] = magnitude
    return result


def _sobel(grey: NDArray[np.int16]) -> NDArray[np.int16]:
    """|Gx| + |Gy| of the inner pixels, through the separable halves of the kernels."""
    smooth = grey[:-2] + grey[2:]
    smooth += grey[1:-1]
    smooth += grey[1:-1]
    gx = smooth[:, 2:] - smooth[:, :-2]
    difference = grey[2:] - grey[:-2]
    gy = difference[:, :-2] + difference[:, 2:]
    gy += difference[:, 1:-1]
    gy += difference[:, 1:-1]
    np.abs(gx, out=gx)
    np.abs(gy, out=gy)
    gx += gy
    return gx


def palettes() -> Frame:
    """The four palettes of `colorise`, (4, 256, 3): heat, cold, rainbow, grey.

    With v the grey value: heat is (3v, 3v - 255, 3v - 510), cold the same from blue to white,
    rainbow (255 - |4v - 765|, 255 - |4v - 510|, 255 - |4v - 255|), grey (v, v, v); each clipped to 0…255.
    """
    v = np.arange(256, dtype=np.int32)
    heat = [3 * v, 3 * v - 255, 3 * v - 510]
    rainbow = [255 - abs(4 * v - 765), 255 - abs(4 * v - 510), 255 - abs(4 * v - 255)]
    table = np.array([heat, heat[::-1], rainbow, [v, v, v]])
    return np.ascontiguousarray(table.clip(0, 255).astype(np.uint8).transpose(0, 2, 1))


class Colorise:
    """Grey to RGB, three bytes for one: the palette is chosen by the register `palette` (0…3)."""

    @cached_property
    def _palettes(self) -> Frame:
        return palettes()

    def __call__(self, frame: Frame, registers: Mapping[str, int]) -> Frame:
        """The (height, width, 3) picture."""
        table = self._palettes[registers.get("palette", 0) % len(self._palettes)]
        return np.take(table, frame, axis=0)


class Models:
    """Models by name; an unknown name passes data as it is."""

    def __init__(self, models: Mapping[str, AnyModel] | None = None) -> None:
        self._standard: dict[str, AnyModel] = dict(models or {})
        self._added: dict[str, AnyModel] = {}
        self._offered: dict[str, AnyModel] | None = {}  # by installed packages; None: not looked for yet

    @classmethod
    def standard(cls) -> Models:
        """`default`, `edge` and `colorise`; blocks' are `cm.simulation.software.hardware.block_models`."""
        return cls({"default": default, "edge": edge, "colorise": Colorise()})

    def __iter__(self) -> Iterator[str]:
        return iter(self._all)

    def get(self, name: str) -> AnyModel:
        """The model of that name, or `default`."""
        return self._all.get(name, default)

    def of_vlnv(self, vlnv: str) -> type[Model] | None:
        """The model of a block: under its VLNV, or that without the version; None if there is none."""
        found = self._all.get(vlnv) or self._all.get(vlnv.rpartition(":")[0])
        return found if isinstance(found, type) and issubclass(found, Model) else None

    def add(self, name: str, model: AnyModel) -> None:
        """Add or replace one."""
        self._added[name] = model

    def check(self, configs: Iterable[Config]) -> None:
        """Raise SimError for a module whose `model` does not exist.

        That of ``turn_left`` in region ``left`` may be ``turn`` without there being one: it is a module's own name,
        of which `cm build` made one for each of several regions.
        """
        here = self._standard.keys() | self._added.keys()  # what packages offer takes long to find
        for config in configs:
            for module in config.modules.values():
                own = module.name == f"{module.model}_{module.region}"
                if module.model is None or module.model in here or own:
                    continue
                if module.model not in self._all:
                    close = difflib.get_close_matches(module.model, self._all, 1)
                    raise SimError(
                        f"module {module.name} of {config.name}: no model is called {module.model!r}"
                        f"{f', did you mean {close[0]!r}?' if close else ''}; there are {', '.join(sorted(self._all))}"
                    )

    def load(self, source: str) -> None:
        """Add the models of a Python file or importable module: those in its mapping ``MODELS``.

        Raises:
            SimError: there is no such module, or no ``MODELS`` in it.
        """
        found = getattr(_import(source), "MODELS", None)
        if not isinstance(found, Mapping):
            raise SimError(f"{source} has no MODELS: it should be a mapping of names to functions")
        self._added.update(found)

    def load_entry_points(self) -> None:
        """Add what installed packages offer under the entry point group ``cm.sim.models``, when it is needed."""
        self._offered = None

    @property
    def _all(self) -> Mapping[str, AnyModel]:
        if self._offered is None:
            self._offered = _offered()
        return {**self._standard, **self._offered, **self._added}


def _offered() -> dict[str, AnyModel]:
    from importlib.metadata import entry_points

    found: dict[str, AnyModel] = {}
    for point in entry_points(group=ENTRY_POINTS):
        try:
            found[point.name] = point.load()
        except Exception:  # noqa: BLE001 - a package's model must not end the board
            _log.exception("the model %s of an installed package could not be loaded", point.name)
    return found


def _import(source: str) -> ModuleType:
    try:
        if not source.endswith(".py"):
            return importlib.import_module(source)
        spec = importlib.util.spec_from_file_location(f"cm_sim_models_{Path(source).stem}", source)
        if spec is None or spec.loader is None:
            raise ImportError(f"{source} cannot be loaded")
        module = importlib.util.module_from_spec(spec)
        sys.modules[spec.name] = module
        spec.loader.exec_module(module)
    except Exception as error:  # whatever a user's file raises
        raise SimError(f"the models of {source} could not be loaded: {error}") from error
    return module
