# SPDX-License-Identifier: Apache-2.0
"""The kernel's fpga_manager (sysfs)."""

from __future__ import annotations

import enum
import errno
from pathlib import PurePosixPath

from cm.device import advice
from cm.device.attributes import Attributes
from cm.device.base import AnyRoot
from cm.device.errors import DeviceError, DeviceInvalid, DeviceUnsupported
from cm.device.paths import Root

CLASS = "sys/class/fpga_manager"
NAME_MAX = 254  # the kernel keeps it in NAME_MAX bytes, the NUL among them


class FpgaFlags(enum.Flag):
    """Flags of a load (include/linux/fpga/fpga-mgr.h)."""

    NONE = 0
    PARTIAL = 1 << 0
    ENCRYPTED = 1 << 2


def list_fpga_managers(root: AnyRoot = None) -> list[str]:
    """Return the names of all managers ("fpga0"), sorted."""
    return advice.names(Root.of(root).join(CLASS))


class FpgaManager:
    """One fpga_manager.  Stateless: attributes are opened for each access; the kernel serialises loads.

    Mainline has ``name``, ``state`` and ``status`` only; `load` needs the attributes ``firmware``
    and ``flags`` that linux-xlnx adds.
    """

    def __init__(self, index: int = 0, root: AnyRoot = None) -> None:
        """Nothing is opened or checked here."""
        self._attributes = Attributes(Root.of(root), f"{CLASS}/fpga{index}")

    @property
    def name(self) -> str:
        """The driver's name for it.  Raises DeviceNotFound."""
        return self._attributes.text("name")

    @property
    def state(self) -> str:
        """What it does, in the kernel's words: "operating", "write", "write error", …"""
        return self._attributes.text("state")

    @property
    def status(self) -> str:
        """The errors of the last load, in the kernel's words; "" if there was none."""
        return self._attributes.text("status")

    @property
    def can_load(self) -> bool:
        """Whether this kernel loads through sysfs (linux-xlnx)."""
        return self._attributes.exists("firmware")

    def load(self, firmware_name: str, partial: bool = False, encrypted: bool = False) -> None:
        """Load /lib/firmware/``firmware_name`` and wait for the end.

        ``encrypted`` means with the device's own key.  Raises DeviceUnsupported on mainline,
        DeviceInvalid for a name outside of the folder, DeviceError with the kernel's state and status.
        """
        self._check(firmware_name)
        if not self.can_load:
            text = (
                f"{self._attributes.path('firmware')} does not exist: this kernel's fpga_manager cannot load through "
                "sysfs (linux-xlnx can); use an overlay with firmware-name, or an ICAP"
            )
            raise DeviceUnsupported(errno.EOPNOTSUPP, text, self._attributes.path("firmware"))
        flags = FpgaFlags.PARTIAL if partial else FpgaFlags.NONE
        flags |= FpgaFlags.ENCRYPTED if encrypted else FpgaFlags.NONE
        self._attributes.write("flags", f"{flags.value:x}".encode())
        self._start(firmware_name)

    def _start(self, firmware_name: str) -> None:
        try:
            self._attributes.write("firmware", firmware_name.encode())
        except DeviceError as error:
            error.strerror = f"{error.strerror}; loading {firmware_name}: state {self.state!r}, status {self.status!r}"
            raise
        state = self.state
        if state != "operating":
            text = f"{self._attributes.path()}: {firmware_name} did not load: state {state!r}, status {self.status!r}"
            raise DeviceError(errno.EIO, text, self._attributes.path())

    def _check(self, name: str) -> None:
        path = PurePosixPath(name)
        if not name or "\n" in name or path.is_absolute() or ".." in path.parts or len(name.encode()) > NAME_MAX:
            text = f"firmware name {name!r}: give a path under lib/firmware, at most {NAME_MAX} bytes, without '..'"
            raise DeviceInvalid(errno.EINVAL, text, self._attributes.path("firmware"))
