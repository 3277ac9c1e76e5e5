# SPDX-License-Identifier: Apache-2.0
"""The board's devices for the manager: opened when needed, kept, closed together; memory for masters in the PL."""

from __future__ import annotations

import errno
import os
import threading
from collections.abc import Callable, Hashable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from cm.device import (
    AxiDma,
    DeviceBusy,
    DeviceError,
    DeviceNotFound,
    FpgaManager,
    GpioLine,
    Icap,
    Overlays,
    PlClocks,
    Root,
    Uio,
    find_uio,
    list_dma,
    list_fpga_managers,
    list_icap,
    list_uio,
)
from cm.device.checks.machine import Machine
from cm.device.other_loads import OtherLoads
from cm.errors import NotFound
from cm.frozen import dataclass
from cm.manager.errors import NoWindow
from cm.manager.inputs import Window

if TYPE_CHECKING:
    from cm.device.register_window import Windows


@dataclass(frozen=True, slots=True)
class DeviceMemory:
    """`length` bytes behind a descriptor, which the device has at `address`; `free` gives them back."""

    fd: int
    length: int
    coherent: bool
    address: int
    free: Callable[[], None]


class _OurFpgaManager(FpgaManager):
    """One whose loads are told apart from those of other programs."""

    def __init__(self, index: int, root: Root, others: OtherLoads) -> None:
        super().__init__(index, root)
        self._others = others

    def load(self, firmware_name: str, partial: bool = False, encrypted: bool = False) -> None:
        with self._others.ours():
            super().load(firmware_name, partial, encrypted)


class _OurOverlays(Overlays):
    """The same of overlays, which may load something."""

    def __init__(self, root: Root, others: OtherLoads) -> None:
        super().__init__(root)
        self._others = others

    def apply(self, name: str, dtbo: bytes) -> None:
        with self._others.ours():
            super().apply(name, dtbo)


_T = TypeVar("_T")
_BOOT_ID = "proc/sys/kernel/random/boot_id"


class BoardDevices:
    """`cm.manager.interfaces.Devices` over `cm.device`. Both threads of the daemon use it."""

    def __init__(self, root: Root, assume_loaded: bool = False) -> None:
        """`assume_loaded`: the operator says that the PL holds a design."""
        self._root, self._assumed = root, assume_loaded
        self.others = OtherLoads(root)
        self._lock = threading.RLock()
        self._open: dict[tuple[str, Hashable], Any] = {}

    @property
    def root(self) -> Path:
        """Where the board's /dev and /sys begin."""
        return self._root.join()

    def boot_id(self) -> str:
        """The kernel's boot id (the simulated board has its own); empty if it cannot be read."""
        try:
            return (self.root / _BOOT_ID).read_text(encoding="ascii").strip()
        except OSError:
            return ""

    def holds_design(self) -> bool:
        """Whether an fpga_manager says so, which a Zynq's PL is asked for: an access of an empty one stalls the bus.

        On Zynq-7000 the kernel knows only of what it loaded itself (zynq-fpga clears the interrupt that it then looks
        at); on ZynqMP it asks the firmware once, at boot.
        """
        if self._assumed or Machine(self._root).family is None:
            return True
        for name in list_fpga_managers(self._root):
            with suppress(DeviceError):
                if self.fpga_manager(name).state == "operating":
                    return True
        return False

    def window(self, address: int, width: int) -> Window:
        """Where a register is mapped. Raises DeviceNotFound with the windows that there are."""
        with self._lock:
            info, index = find_uio(address, width // 8, self._root)
            uio = self.uio(info.node)
            return Window(uio, index, address - uio.maps[index].address)

    def windows(self) -> Windows:
        """What lends register pages; the caller's. Raises NoWindow where nothing does."""
        from cm.device.register_window import Windows

        try:
            return Windows.open(self._root)
        except DeviceNotFound as error:
            why = "the kernel module cm_window is not loaded (modprobe cm_window)"
            if self._root.simulated:
                why = (
                    "this simulated board lends no registers: its logic has to see each access (--sim=rtl, --sim=bits)"
                )
            raise NoWindow(f"{why}; they go by requests as before") from error

    def _kept(self, kind: str, name: Hashable, opens: Callable[[], _T]) -> _T:
        with self._lock:
            handle: _T | None = self._open.get((kind, name))
            if handle is None:
                handle = self._open[kind, name] = opens()
            return handle

    def uio(self, name: str) -> Uio:
        """An open UIO device, by its node's or its own name."""
        return self._kept("uio", name, lambda: Uio.open(name, self._root))

    def icap(self, name: str | None) -> Icap:
        """An open configuration port; ``cm_icap0`` if no name is given."""
        name = name or "cm_icap0"
        return self._kept("icap", name, lambda: Icap.open(name, self._root))

    def gpio(self, chip: str, line: int | str) -> GpioLine:
        """A line of a GPIO chip, held until the board is lost: given back, it may change."""
        return self._kept("gpio", (chip, line), lambda: GpioLine.open(chip, line, self._root))

    def fpga_manager(self, name: str | None) -> FpgaManager:
        """The kernel's FPGA manager: ``fpga0`` if no name is given. Raises DeviceNotFound for any other name."""
        number = (name or "fpga0").removeprefix("fpga")
        if not number.isdecimal():
            raise DeviceNotFound(errno.ENOENT, f"no fpga_manager {name!r}: their names are fpga0, fpga1, …")
        return _OurFpgaManager(int(number), self._root, self.others)

    def overlays(self) -> Overlays:
        """The overlays in configfs."""
        return _OurOverlays(self._root, self.others)

    def clocks(self) -> PlClocks:
        """The clocks of the processing system for the PL."""
        return PlClocks(self._root)

    def dma(self, channel: str) -> AxiDma:
        """A DMA channel, opened anew: its handle belongs to the caller, who closes it."""
        return AxiDma.open(channel, self._root)

    def memory(self, length: int) -> DeviceMemory:
        """Memory in one piece for masters in the PL: whole pages, `length` bytes at least.

        Raises DeviceError, NotFound if no device provides any. A DMA channel may be open once only: it is closed at
        once, and the descriptor alone keeps the memory.
        """
        with suppress(DeviceNotFound):
            return self.port_memory(length)
        busy: DeviceError | None = None
        for name in list_dma(self._root):
            try:
                with self.dma(name) as channel:
                    buffer = channel.allocate(length)
                    fd = os.dup(buffer.fd)
                    return DeviceMemory(fd, buffer.length, buffer.coherent, buffer.address, partial(os.close, fd))
            except DeviceBusy as error:
                busy = error
        raise busy or NotFound(
            "no device of this board gives memory: it has neither a configuration port nor a DMA channel"
        )

    def port_memory(self, length: int) -> DeviceMemory:
        """Likewise, of a configuration port only, which may be open several times: an open one of our own holds it.

        Any thread. Raises DeviceError; DeviceNotFound where there is none.
        """
        port = Icap.open(root=self._root)
        try:
            buffer = port.allocate(length)
        except BaseException:
            port.close()
            raise

        def free() -> None:
            with suppress(DeviceError):
                buffer.close()
            port.close()

        return DeviceMemory(buffer.fd, buffer.length, buffer.coherent, buffer.address, free)

    def check(self) -> None:
        """Raise DeviceError if the board no longer answers: ask its ports, or open a window."""
        ports = {*(str(name) for kind, name in self._open if kind == "icap"), *list_icap(self._root)}
        for name in sorted(ports):
            self.icap(name).status()
        for info in [] if ports else list_uio(self._root)[:1]:
            Uio.open(info.node, self._root).close()

    def forget(self) -> bool:
        """Close UIO devices and ports that have gone, or are others now; the next use opens them anew."""
        with self._lock:
            gone = [key for key, handle in self._open.items() if key[0] != "gpio" and not handle.present]
            for key in gone:
                self._open.pop(key).close()
            return bool(gone)

    def lost(self) -> None:
        """Close everything; the next use opens it anew."""
        with self._lock:
            for handle in self._open.values():
                handle.close()
            self._open.clear()
