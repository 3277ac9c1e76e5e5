# SPDX-License-Identifier: Apache-2.0
"""The steps of a change, as data: `cm.manager.planner` orders them, `cm.manager.execution.transaction` takes them."""

from __future__ import annotations

from cm.frozen import dataclass
from cm.manager.inputs import Image
from cm.schema.clock_rates import hertz as hertz
from cm.schema.model import Clock, LoaderKind, Module, Overlay, Region, Register, StaticIdentity
from cm.wire.messages.status import place


@dataclass(frozen=True, slots=True)
class Choice:
    """A port, and why it is not the one before it in the order (empty: it is the first)."""

    kind: LoaderKind
    why: str = ""


Place = tuple[int, int]  # of a register: physical address, and width in bits


class _Step:
    __slots__ = ()

    @property
    def length(self) -> int:
        """Bytes that go through a configuration port."""
        return 0


class _OfRegion(_Step):
    __slots__ = ()
    region: Region

    @property
    def subject(self) -> str:
        return self.region.name


@dataclass(frozen=True, slots=True)
class Validate(_Step):
    """Everything this plan loads was read and found good before the first step touches anything."""

    images: tuple[Image, ...]
    kind = "validate"

    @property
    def subject(self) -> str:
        return ", ".join(image.path.name for image in self.images)

    @property
    def text(self) -> str:
        return f"check {self.subject or 'nothing to load'}"


@dataclass(frozen=True, slots=True)
class CheckStatic(_Step):
    """Read the static part's identity, before a partial bitstream is loaded into it."""

    config: str
    static: StaticIdentity | None  # None, or one without a register: nothing can be asked
    kind = "static"

    @property
    def known(self) -> bool:
        """Whether the board can be asked, and the right answer is known."""
        return self.static is not None and self.static.identity is not None and self.static.base_address is not None

    @property
    def subject(self) -> str:
        return self.config

    @property
    def text(self) -> str:
        if not self.known or self.static is None:
            return f"assume the static part of {self.config} (its identity is not known)"
        return f"check that the static part is {self.static.identity:#x}"


@dataclass(frozen=True, slots=True)
class Quiesce(_Step):
    """Stop streams whose region or shape changes."""

    streams: tuple[str, ...]
    kind = "quiesce"

    @property
    def subject(self) -> str:
        return ", ".join(self.streams)

    @property
    def text(self) -> str:
        return f"stop streams {self.subject}"


@dataclass(frozen=True, slots=True)
class RemoveOverlay(_Step):
    """Take a device-tree overlay off."""

    name: str
    kind = "overlay_remove"

    @property
    def subject(self) -> str:
        return self.name

    @property
    def text(self) -> str:
        return f"remove overlay {self.name}"


@dataclass(frozen=True, slots=True)
class Decouple(_OfRegion):
    """Isolate a region from the static part."""

    region: Region
    kind = "decouple"

    @property
    def text(self) -> str:
        return f"decouple {self.region.name}" + ("" if self.region.decoupler else " (it has no decoupler)")


@dataclass(frozen=True, slots=True)
class Load(_OfRegion):
    """Load a module's bitstream into its region."""

    region: Region
    module: Module
    image: Image
    timeout: float  # seconds
    overlay: bytes = b""  # the .dtbo with `firmware-name`, for a region that is loaded by overlay
    kind = "load"

    @property
    def length(self) -> int:
        return self.image.length

    @property
    def port_kind(self) -> LoaderKind:
        return self.region.loader

    @property
    def text(self) -> str:
        return f"load {self.module.name} into {self.region.name} by {self.region.loader.value}"


@dataclass(frozen=True, slots=True)
class LoadStatic(_Step):
    """Load a whole image; every region's content is lost."""

    image: Image
    timeout: float
    config: str  # whose image it is
    loader: LoaderKind
    kind = "load_full"

    @property
    def length(self) -> int:
        return self.image.length

    @property
    def port_kind(self) -> LoaderKind:
        return self.loader

    @property
    def subject(self) -> str:
        return self.image.path.name

    @property
    def text(self) -> str:
        return f"load the whole device from {self.image.path.name} by {self.loader.value}"


@dataclass(frozen=True, slots=True)
class ApplyOverlay(_Step):
    """Put a device-tree overlay on."""

    overlay: Overlay
    data: bytes
    sha256: str
    kind = "overlay_apply"

    @property
    def subject(self) -> str:
        return self.overlay.name

    @property
    def text(self) -> str:
        return f"apply overlay {self.overlay.name}"


@dataclass(frozen=True, slots=True)
class Recouple(_OfRegion):
    """Connect a region again."""

    region: Region
    resets: frozenset[str]  # names of its registers: a load, or a reset while it was cut off, has put them back
    kind = "recouple"

    @property
    def text(self) -> str:
        return f"recouple {self.region.name}"


@dataclass(frozen=True, slots=True)
class CheckIdentity(_OfRegion):
    """Read a module's identity."""

    region: Region
    module: Module
    kind = "verify"

    @property
    def text(self) -> str:
        return f"check that {self.region.name} holds {self.module.name}"


@dataclass(frozen=True, slots=True)
class SetRegister(_Step):
    """Write a register and, where it can be, read it back."""

    register: Register
    value: int
    restores: bool = False  # on the way back: a register that the configuration has no name for
    kind = "registers"

    @property
    def subject(self) -> str:
        return self.register.name

    @property
    def text(self) -> str:
        return f"set {self.register.name} = {self.value:#x}"


@dataclass(frozen=True, slots=True)
class SetClock(_Step):
    """Set a clock and read it back."""

    clock: Clock  # with the rate that is wanted
    before: int  # Hz; 0: no driver of this board can set clocks
    achieved: int | None  # Hz that it will run at; None where that cannot be known beforehand
    running: bool
    restores: bool = False  # on the way back: as near as it can be had is right
    asked: int = 0  # Hz that the driver is told to make, because it rounds down; 0: the clock's rate
    kind = "clock"

    @property
    def subject(self) -> str:
        return self.clock.name

    @property
    def text(self) -> str:
        if not self.before:
            return f"leave clock {self.clock.name} as it is: {hertz(self.clock.rate)} is wanted, no driver here sets it"
        will = f", which makes {hertz(self.achieved)}" if self.achieved not in (None, self.clock.rate) else ""
        return f"set clock {self.clock.name} to {hertz(self.clock.rate)}{will} (now {hertz(self.before)})"


@dataclass(frozen=True, slots=True)
class Repair(_OfRegion):
    """Write frames anew that are wrong, under the module that runs there."""

    region: Region
    module: Module
    image: Image
    words: bytes  # for the port
    frames: int
    timeout: float  # seconds
    kind = "repair"

    @property
    def text(self) -> str:
        return f"write {self.frames} frame{'s' if self.frames > 1 else ''} of {self.region.name} again"


@dataclass(frozen=True, slots=True)
class Publish(_Step):
    """The board is in the new mode: say so, and let the streams run."""

    config: str
    mode: str  # empty: in none, after an unload
    kind = "publish"

    @property
    def subject(self) -> str:
        return place(self.config, self.mode)

    @property
    def text(self) -> str:
        return f"publish {self.subject}{' and start its streams' if self.mode else ''}"


Step = (
    Validate
    | CheckStatic
    | Quiesce
    | RemoveOverlay
    | Decouple
    | Load
    | LoadStatic
    | ApplyOverlay
    | Recouple
    | CheckIdentity
    | SetRegister
    | SetClock
    | Repair
    | Publish
)
