# SPDX-License-Identifier: Apache-2.0
"""What other programs do to the PL through the kernel, noticed without an access of the logic.

The kernel tells nobody of a load: an fpga_manager's `state` is the same after it as before. But a write to its
`firmware` (fpgautil, PYNQ) is an event of inotify(7), and an overlay that loads (xmutil, fpgautil -o) is an entry in
configfs. Neither shows a load over JTAG, through devcfg, an ICAP, or linux-xlnx's /dev/fpga0.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress

from cm.device.base import AnyRoot
from cm.device.errors import DeviceError
from cm.device.fpga_manager import CLASS, FpgaManager, list_fpga_managers
from cm.device.native import attr as native
from cm.device.overlays import APPLIED, FOLDER, Overlays
from cm.device.paths import Root
from cm.frozen import dataclass

_EVENT = struct.Struct("iIII")  # inotify(7): watch, mask, cookie, and the bytes of the name that follows
_ROOM = 64 * 1024
_LOADS = (b"firmware", b"state")  # written by who loads; replaced by the simulated board for each load


@dataclass(frozen=True, slots=True)
class Seen:
    """What others have done since the last look: loads, in sentences, and overlays that they have removed."""

    loads: tuple[str, ...] = ()
    removed: tuple[str, ...] = ()


class OtherLoads:
    """Watches the fpga_managers and the overlays of a board. Nothing is opened before `begin`."""

    def __init__(self, root: AnyRoot = None) -> None:
        self._root = Root.of(root)
        self._overlays = Overlays(self._root)
        self._watches: dict[str, int] = {}
        self._seen: set[str] = set()  # managers that others have written to
        self._known: frozenset[str] = frozenset()

    def begin(self) -> None:
        """Take all that is there for known."""
        self.close()
        self._watch()
        self._known = frozenset(self._overlays.list())

    @contextmanager
    def ours(self) -> Iterator[None]:
        """What is loaded inside is our own; not while another thread looks."""
        self._seen |= self._written()
        try:
            yield
        finally:
            self._written()

    def look(self, ours: Collection[str]) -> Seen:
        """What others have done since the last look; `ours`: names of overlays that the caller has applied."""
        written, self._seen = sorted(self._seen | self._written()), set()
        self._watch()
        there = self._overlays.list()
        new = [name for name in there if name not in self._known and name not in ours]
        applied = [name for name in new if self._is_applied(name)]
        self._known = frozenset(there) - (frozenset(new) - frozenset(applied))
        loads = [f"{name} was told to load an image (it says {self._state(name)!r})" for name in written]
        loads += [f"overlay {name} was applied, which loads one" for name in applied if self._may_load(name)]
        return Seen(tuple(loads), tuple([name for name in ours if name not in there]))

    def who(self) -> str:
        """Programs that may have done it, and what ends them, for a sentence."""
        from cm.device.checks.machine import Machine
        from cm.device.checks.other_managers import told

        return told(Machine(self._root))

    def close(self) -> None:
        """Watch nothing any more; twice is fine."""
        for descriptor in self._watches.values():
            os.close(descriptor)
        self._watches.clear()

    def _watch(self) -> None:
        """Those that an overlay has brought, too."""
        for name in list_fpga_managers(self._root):
            if name not in self._watches:
                with suppress(OSError):  # a kernel without inotify
                    self._watches[name] = native.watch(self._root.prefix, f"{CLASS}/{name}")

    def _written(self) -> set[str]:
        """The managers that were told to load something."""
        written = set()
        for name, descriptor in self._watches.items():
            with suppress(BlockingIOError):
                while events := os.read(descriptor, _ROOM):
                    if any(file in _LOADS for file in _names(events)):
                        written.add(name)
        return written

    def _state(self, name: str) -> str:
        try:
            return FpgaManager(int(name.removeprefix("fpga")), self._root).state
        except (DeviceError, ValueError):
            return "nothing"

    def _is_applied(self, name: str) -> bool:
        try:
            return self._overlays.status(name) == APPLIED
        except DeviceError:
            return False

    def _may_load(self, name: str) -> bool:
        """Whether it names firmware, or cannot be read."""
        for read in (self._blob, self._file):
            with suppress(OSError, DeviceError):
                if blob := read(name):
                    return b"firmware-name" in blob
        return True

    def _blob(self, name: str) -> bytes:
        return native.read(self._root.prefix, f"{FOLDER}/{name}/dtbo")

    def _file(self, name: str) -> bytes:
        """The file that the kernel was told to read; `dtbo` is empty then."""
        path = native.read(self._root.prefix, f"{FOLDER}/{name}/path").decode("utf-8", "replace").strip()
        return self._root.join("lib/firmware", path).read_bytes() if path else b""


def _names(events: bytes) -> Iterator[bytes]:
    at = 0
    while at < len(events):
        *_, length = _EVENT.unpack_from(events, at)
        at += _EVENT.size + length
        yield events[at - length : at].rstrip(b"\0")
