# SPDX-License-Identifier: Apache-2.0
"""Device-tree overlays through configfs (linux-xlnx, or the dtbocfg module elsewhere)."""

from __future__ import annotations

import errno
import re
from collections.abc import Callable
from typing import TypeVar

from cm.device import advice
from cm.device.attributes import Attributes
from cm.device.base import AnyRoot
from cm.device.errors import DeviceError, DeviceInvalid, DeviceNotFound, DeviceUnsupported
from cm.device.paths import Root
from cm.device.probing import await_drivers, device_names, hand_over_windows

_T = TypeVar("_T")
FOLDER = "sys/kernel/config/device-tree/overlays"
APPLIED = "applied"
# dtbocfg uses 0 and 1 where linux-xlnx uses words, and applies an overlay when a 1 is written.
_WORDS = {"0": "unapplied", "1": APPLIED}
_SWITCH_ON = b"1"
_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9._-]*")
_MAGIC = b"\xd0\x0d\xfe\xed"  # of a flattened device tree, v17


class Overlays:
    """The overlays of a board.  Stateless: the kernel keeps them, also when we end."""

    def __init__(self, root: AnyRoot = None) -> None:
        """Nothing is opened or checked here."""
        self._attributes = Attributes(Root.of(root), FOLDER)

    def available(self) -> bool:
        """Whether this kernel has the interface."""
        return self._attributes.exists()

    def list(self) -> list[str]:
        """Return the names of all overlays there are, sorted; none without the interface."""
        root = self._attributes.root
        return [name for name in advice.names(root.join(FOLDER)) if root.join(FOLDER, name).is_dir()]

    def has(self, name: str) -> bool:
        """Whether there is an overlay of this name; False without the interface."""
        return self._attributes.exists(name)

    def status(self, name: str) -> str:
        """Return the kernel's word for an overlay: "applied" or "unapplied".  Raises DeviceNotFound."""
        self._check(name)
        text = self._in_folder(self._attributes.text, f"{name}/status")
        return _WORDS.get(text, text)

    def apply(self, name: str, dtbo: bytes) -> None:
        """Apply the overlay ``dtbo`` under ``name``, and see that its devices get their drivers.

        One that is refused, or whose devices a driver does not take, is removed again.  Raises DeviceExists if the
        name is taken, DeviceInvalid for what is not a device-tree blob, DeviceUnsupported, DeviceError with the
        kernel's word, or with each device and driver and who holds its interrupt or window.
        """
        self._check(name)
        if not dtbo.startswith(_MAGIC):
            text = f"overlay {name}: not a device-tree blob (it has to begin with d0 0d fe ed); compile it with dtc"
            raise DeviceInvalid(errno.EINVAL, text, self._attributes.path(name))
        root = self._attributes.root
        before = device_names(root)
        self._in_folder(self._attributes.mkdir, name)
        try:
            self._attributes.write(f"{name}/dtbo", dtbo)
            self._confirm(name)
            await_drivers(root, before, name)
            hand_over_windows(root, before)
        except BaseException as error:
            self._undo(name, error)
            raise

    def remove(self, name: str) -> None:
        """Remove an overlay.  Remove in the reverse order of `apply`.  Raises DeviceNotFound, DeviceBusy."""
        self._check(name)
        self._in_folder(self._attributes.rmdir, name)

    def _confirm(self, name: str) -> None:
        """Read the result: configfs applies at close(), which reports no errors."""
        text = self._attributes.text(f"{name}/status")
        if text == "0":
            self._attributes.write(f"{name}/status", _SWITCH_ON)
            text = self._attributes.text(f"{name}/status")
        word = _WORDS.get(text, text)
        if word != APPLIED:
            text = (
                f"the kernel did not apply overlay {name}: status says {word!r}; its log (dmesg) says why, often a "
                "target that the base tree lacks, or symbols in a base tree built without 'dtc -@'"
            )
            raise DeviceError(errno.EIO, text, self._attributes.path(name))

    def _undo(self, name: str, cause: BaseException) -> None:
        try:
            self._attributes.rmdir(name)
        except DeviceError as error:
            if isinstance(cause, DeviceError) and cause.strerror:
                cause.strerror += f"; and it could not be removed again: {error}"

    def _check(self, name: str) -> None:
        if not _NAME.fullmatch(name):
            text = f"overlay name {name!r}: use letters, digits, '.', '_' and '-', and no '.' or '-' first"
            raise DeviceInvalid(errno.EINVAL, text, self._attributes.path())

    def _in_folder(self, call: Callable[[str], _T], name: str) -> _T:
        """What is done in the folder; where there is none, that is what is wrong. Raises DeviceUnsupported."""
        try:
            return call(name)
        except DeviceNotFound as error:
            if self.available():
                raise
            text = (
                f"{self._attributes.path()} does not exist: this kernel has no overlay interface; "
                "use linux-xlnx with OF_CONFIGFS, or load our cm_overlay module or dtbocfg (and mount configfs)"
            )
            raise DeviceUnsupported(errno.EOPNOTSUPP, text, self._attributes.path()) from error
