# SPDX-License-Identifier: Apache-2.0
"""Registers of a module, mapped: ``with board.registers.window("edge", write=True) as regs: regs.focus = 2``.

Each access is one load or store of the C shim. What the schema says of a register is compiled into a property, when
the pages come, so that nothing is looked up on the way.
"""

from __future__ import annotations

import errno
import os
import socket
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from operator import index
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import TYPE_CHECKING, Any, ClassVar, NoReturn, SupportsIndex, TypeVar

from cm.client.after_fork import not_for_children
from cm.client.data_socket import connect, descriptors
from cm.client.errors import BoardClosed, ConnectionLost, RequestInvalid, RequestNotFound, WindowRevoked, request_error
from cm.device.errors import device_error
from cm.device.native.call import last_error
from cm.device.native.window import read as read_wide
from cm.device.native.window import read32, write_plain
from cm.device.register_window import MappedWindow, WindowEnd
from cm.errors import InvalidRequest, Timeout
from cm.field_access import KINDS, Rest, changed_too, must_not_be_read, rest_of
from cm.frozen import replace
from cm.wire import plane_packets as packets
from cm.wire.encode import decoded
from cm.wire.messages.status import ConfigInfo, ErrorInfo, MemoryInfo, RegisterInfo
from cm.wire.plane_packets import DESCRIPTOR, PACKET_MAX, Descriptor, Open, WindowPages

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from cm.client.core.leases import HeldLeases

_T = TypeVar("_T")
_TABLE = 64 << 20  # bytes of a table of registers
_TOLD = 1.0  # seconds for the manager to say what became of pages that are gone
_WHY: dict[int, str] = {
    WindowEnd.CALL: "the manager took it back",
    WindowEnd.BRIDGE: "its region was cut off",
    WindowEnd.OWNER: "the manager has ended",
    WindowEnd.GONE: "its device is gone",
    WindowEnd.SLEEP: "the machine slept",
}


class _Loan:
    """A connection to the data socket that holds pages: while it is open, and until the manager takes them back."""

    def __init__(self, folder: Path, wanted: Open) -> None:
        self._process = os.getpid()
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        try:
            connect(self.socket, folder)
            self.socket.send(packets.encode_open(wanted))
        except BaseException:
            self.socket.close()
            raise

    def pages(self, timeout: float | None) -> tuple[WindowPages, MappedWindow, ConfigInfo]:
        """What was lent. Raises the manager's refusal, Timeout, ConnectionLost."""
        packet, fds = self._packet(timeout)
        try:
            if len(fds) != 2:
                raise ConnectionLost("the manager's answer has no pages")
            size = min(os.fstat(fds[1]).st_size, _TABLE)
            return packets.decode_window(packet), MappedWindow(fds[0]), decoded(ConfigInfo, os.pread(fds[1], size, 0))
        except ConnectionLost:  # an OSError too
            raise
        except OSError as error:
            raise ConnectionLost(f"the manager's answer has pages that cannot be used: {error}") from error
        finally:
            for fd in fds:
                os.close(fd)

    def _packet(self, timeout: float | None) -> tuple[bytes, list[int]]:
        self.socket.settimeout(timeout)
        try:
            packet, ancillary, _, _ = self.socket.recvmsg(PACKET_MAX, socket.CMSG_SPACE(8))
        except (TimeoutError, BlockingIOError):  # the latter of one who does not wait
            raise Timeout(f"a window: the manager did not answer within {timeout or 0:g} s") from None
        except OSError as error:
            raise ConnectionLost(f"the configuration manager's data socket: {error}") from error
        fds = descriptors(ancillary)
        if len(packet) >= DESCRIPTOR.size and packet[2] == packets.WINDOW:
            return packet, fds
        for fd in fds:
            os.close(fd)
        if len(packet) < DESCRIPTOR.size:
            raise ConnectionLost("the configuration manager hung up on the data socket")
        if Descriptor._make(DESCRIPTOR.unpack_from(packet)).kind == packets.REFUSED:
            raise request_error(ErrorInfo(*packets.decode_refused(packet)))
        return packet, []

    def fate(self) -> tuple[int, str, str]:
        """Why the pages were taken back, and the configuration and mode that the board goes to."""
        try:
            return packets.decode_revoked(self._packet(_TOLD)[0])
        except (ConnectionLost, Timeout, InvalidRequest):
            return int(WindowEnd.OWNER), "", ""

    def close(self) -> None:
        """Give them back. A thread that waits for an answer gets ConnectionLost; a forked child's parent does not."""
        if os.getpid() == self._process:
            with suppress(OSError):
                self.socket.shutdown(socket.SHUT_RDWR)
        self.socket.close()


class RegisterWindow:
    """Registers as attributes (``regs.focus``), registers and fields as items (``regs["control.enable"]``).

    Threads may share it; writing a field is a read and a write, so two threads that write fields of one register need
    a lock of their own. Any access raises WindowRevoked once the manager has taken the pages back, unless the window
    waits until the same module is there again (`wait`); a write is then made again, there.
    """

    # fmt: off
    __slots__ = ("__weakref__", "_fate", "_folder", "_goes_on", "_handle", "_leases", "_loan", "_lock", "_mapped",
                 "_owner", "_pages", "_seen", "_timeout", "_wanted", "_why")
    # fmt: on
    _readers: ClassVar[Mapping[str, Callable[[Any], int]]] = MappingProxyType({})
    _writers: ClassVar[Mapping[str, Callable[[Any, Any], None]]] = MappingProxyType({})
    _registers: ClassVar[Mapping[str, RegisterInfo]] = MappingProxyType({})
    _memories: ClassVar[Mapping[str, MemoryInfo]] = MappingProxyType({})
    _table: ClassVar[ConfigInfo] = ConfigInfo()

    def __init__(
        self,
        folder: Path,
        wanted: Open,
        timeout: float | None,
        leases: HeldLeases,
        owner: object,
        goes_on: bool = False,
    ) -> None:
        """`timeout` in seconds, of waiting for the pages; `owner` lives as long as this does.

        `goes_on`: an access whose pages were taken back waits until the same module is there again.
        """
        self._goes_on = goes_on
        self._folder, self._wanted, self._timeout = folder, wanted, timeout
        self._leases, self._owner = leases, owner
        self._lock = threading.RLock()  # of taking pages anew
        self._seen: dict[str, int] = {}  # what was written to registers that are not read for a write of a field
        self._why: BoardClosed | None = None
        self._fate: tuple[int, str, str] | None = None
        self._loan: _Loan | None = None
        self._mapped: MappedWindow | None = None

    def open(self) -> None:
        """Take the pages. Raises RequestFailed, RequestBusy where the module is not there, Timeout."""
        self._take(self._wanted, self._timeout)
        not_for_children(self)

    def _take(self, wanted: Open, timeout: float | None) -> None:
        held = self._leases.named(wanted.lease)  # as of now: one that was taken since the last time counts
        loan = self._loan = _Loan(self._folder, replace(wanted, lease=held))
        if self._why is not None:  # closed meanwhile, before there was anything to be closed
            loan.close()
        try:
            pages, mapped, table = loan.pages(timeout)
        except BaseException:
            loan.close()
            if self._why is not None:
                raise self._why from None
            raise
        if pages.lease:
            self._leases.add(pages.lease)
        self._fate = None
        self._pages, self._mapped, self._handle = pages, mapped, mapped.shim_handle
        self.__class__ = _compiled(pages, table) if table != self._table else type(self)
        if self._why is not None:
            self._end(self._why)
            raise self._why

    # ---- what it is -----------------------------------------------------------------

    @property
    def region(self) -> str:
        """The region whose registers they are; "static": outside all regions."""
        return self._pages.region

    @property
    def module(self) -> str:
        """The module that the region holds."""
        return self._pages.module

    @property
    def revoked(self) -> bool:
        """Whether the pages were taken back, or given back."""
        return self._mapped is None or self._why is not None or self._mapped.revoked is not None

    def __iter__(self) -> Any:
        """Names of the registers."""
        return iter(self._registers)

    def __len__(self) -> int:
        return len(self._registers)

    def __repr__(self) -> str:
        ended = ", closed" if self._why else ", revoked" if self.revoked else ""
        return f"<window of {self.module or self.region}{ended}>"

    # ---- by name ---------------------------------------------------------------------

    def __getitem__(self, name: str) -> int:
        reader = self._readers.get(name)
        if reader is None:
            self._unknown(name)
        return reader(self)

    def __setitem__(self, name: str, value: SupportsIndex | str) -> None:
        writer = self._writers.get(name)
        if writer is None:
            self._unknown(name)
        writer(self, value)

    def _unknown(self, name: str) -> NoReturn:
        there = ", ".join(self._readers) or "none"
        raise RequestNotFound(ErrorInfo("unknown_register", f"no register {name!r} in this window; there are {there}"))

    def word(self, address: int) -> Callable[[], int]:
        """What loads the word at a physical address, as often as it is called; raises what an access by name does."""
        offset = address - self._pages.address
        if not 0 <= offset <= self._pages.length - 4:
            raise InvalidRequest(f"{address:#x} is not in {self!r}")

        def load() -> int:
            handle = self._handle
            value: int = read32(handle, offset, 32)
            if value < 0:
                self._failed(handle)
                return load()
            return value

        return load

    # ---- several at once ----------------------------------------------------------------

    def array(self, name: str, count: int = 1) -> npt.NDArray[np.uint32]:
        """Registers of 32 bits that follow `name`, `count` of them with it, read by one call; or a memory's content.

        Each register is one access. All of them must be registers that can be read.
        """
        import numpy as np

        memory = self._memories.get(name)
        offset, length = self._place(name, count, writes=False)
        data = self._call(lambda mapped: mapped.read_block(offset, length))
        if memory is None:
            return np.frombuffer(data, np.uint32)
        found = np.frombuffer(data, np.dtype(memory.dtype).newbyteorder("<"))
        return found.reshape(memory.shape) if memory.shape else found

    def put_array(self, name: str, values: npt.ArrayLike) -> None:
        """Write registers of 32 bits from `name` on by one call, in ascending order; or a memory's content."""
        import numpy as np

        memory = self._memories.get(name)
        kind = np.dtype(memory.dtype if memory else np.uint32).newbyteorder("<")
        array = np.ascontiguousarray(values)
        if memory is None:
            array = _words(name, array, self._limits(name, array.size))
        data = array.astype(kind, copy=False).tobytes()
        offset, _ = self._place(name, len(data) // 4, writes=True)
        if memory is not None and len(data) != memory.size:
            raise InvalidRequest(f"memory {name!r} has {memory.size} bytes; these are {len(data)}")
        self._call(lambda mapped: mapped.write_block(offset, data))

    def _place(self, name: str, count: int, writes: bool) -> tuple[int, int]:
        """Offset and bytes of what an array covers. Raises RequestNotFound, RequestInvalid."""
        if writes and not self._pages.writable:
            self._only_read()
        memory = self._memories.get(name)
        if memory is not None:
            _check_access(name, memory.access, writes)
            return memory.address - self._pages.address, memory.size
        run = self._run(name, count)
        for register in run:
            _check_access(register.name, register.access, writes)
        return run[0].address - self._pages.address, 4 * count

    def _only_read(self) -> NoReturn:
        text = f"the window of {self.module or self.region} is for reading"
        raise RequestInvalid(ErrorInfo("access", text))

    def _run(self, name: str, count: int) -> list[RegisterInfo]:
        """The registers that an array covers: a word that is none might do something when it is read."""
        first = self._registers.get(name)
        if first is None:
            self._unknown(name)
        by_address = {r.address: r for r in self._registers.values() if r.width == 32}
        run = [by_address.get(first.address + 4 * i) for i in range(count)]
        known = [register for register in run if register is not None]
        if count < 1 or len(known) < count:
            raise InvalidRequest(f"{count} registers of 32 bits from {name!r} on: {len(known)} of them are there")
        return known

    def _limits(self, name: str, count: int) -> tuple[list[int], list[int]]:
        run = self._run(name, count)
        low = [r.minimum or 0 for r in run]
        return low, [(1 << 32) - 1 if r.maximum is None else r.maximum for r in run]

    # ---- when pages are gone ---------------------------------------------------------

    def _call(self, access: Callable[[MappedWindow], _T]) -> _T:
        while True:
            mapped = self._mapped
            if mapped is None:
                self._raise_closed()
            try:
                return access(mapped)
            except OSError as error:
                self._after(error, mapped)

    def _failed(self, handle: Any) -> None:
        """An access of the shim failed; returns where it is to be made again."""
        mapped = self._mapped
        error = last_error()
        if mapped is None:
            self._raise_closed()
        if mapped.shim_handle is handle:
            self._after(device_error(error, "access", f"a window of {self.module or self.region}"), mapped)

    def _after(self, error: OSError, mapped: MappedWindow) -> None:
        """Raise what it means, or wait until the module is back."""
        if self._why is not None:
            self._raise_closed()
        if error.errno not in (errno.ESTALE, errno.EBADF):  # the latter where waiting has failed before
            raise error
        with self._lock:
            if self._mapped is not mapped:  # another thread has taken new ones
                return
            if not self._goes_on:
                raise self._revoked(*self._told()) from None
            self._let_go()
            self._take(replace(self._wanted, name=self._pages.module or self._pages.region), self._timeout)

    def _told(self) -> tuple[int, str, str]:
        """What the manager says of the end; it says so once."""
        if self._fate is None:
            self._fate = self._loan.fate() if self._loan is not None else (int(WindowEnd.OWNER), "", "")
        return self._fate

    def _revoked(self, reason: int, config: str, mode: str) -> WindowRevoked:
        why = _WHY.get(reason, "it has ended")
        to = f"; the board goes to {config}/{mode}" if mode else ""
        if reason == WindowEnd.CALL and (config, mode) == (self._pages.config_name, self._pages.mode):
            to = f": a lease keeps it off, your own if it was taken later, or {config}/{mode} is loaded again"
        return WindowRevoked(f"the window of {self.module or self.region} is gone: {why}{to}", config, mode)

    def _raise_closed(self) -> NoReturn:
        raise self._why or BoardClosed(f"the window of {self._wanted.name!r} was closed: open another")

    def _let_go(self) -> None:
        """Give pages and lease back."""
        if self._loan is not None:
            self._loan.close()
        if self._mapped is not None:
            self._mapped.close()
            if self._pages.lease:
                self._leases.remove(self._pages.lease)

    # ---- life -----------------------------------------------------------------------

    def end(self, because: BoardClosed) -> None:
        """The board is closed: any later access, and one that waits, raises `because`."""
        self._end(because)

    def _end(self, because: BoardClosed) -> None:
        self._why = self._why or because
        self._let_go()

    def disown(self) -> None:
        """This process was forked: the pages are the parent's."""
        self._lock = threading.RLock()
        self._why = BoardClosed("the window belongs to the process that this one was forked from: open another here")
        if self._loan is not None:
            self._loan.socket.close()
        if self._mapped is not None:
            self._mapped.close()

    def close(self) -> None:
        """Give the pages back; twice is fine."""
        self._end(BoardClosed(f"the window of {self._wanted.name!r} was closed: open another"))

    def __enter__(self) -> Any:
        """Typed as anything: the registers are attributes."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self.close()


def _words(name: str, array: Any, limits: tuple[list[int], list[int]]) -> Any:
    """The values, if all are whole numbers that their registers allow. Raises RequestInvalid."""
    import numpy as np

    flat = array.reshape(-1)
    if flat.dtype.kind not in "iub":
        raise InvalidRequest(f"registers from {name!r} on take integers, not {flat.dtype}")
    low, high = (np.asarray(limit, np.uint64) for limit in limits)
    negative = flat < 0
    wrong = negative | (flat.astype(np.uint64) < low) | (flat.astype(np.uint64) > high)
    if wrong.any():
        at = int(np.argmax(wrong))
        _refuse(f"{name}+{at}", int(flat[at]), int(low[at]), int(high[at]))
    return flat


def _check_access(name: str, access: str, writes: bool) -> None:
    if access == ("ro" if writes else "wo"):
        _no_access(name, writes)


def _no_access(name: str, writes: bool) -> NoReturn:
    raise RequestInvalid(ErrorInfo("access", f"{name!r} is {'read' if writes else 'write'}-only"))


def _refuse(name: str, value: int, low: int, high: int) -> NoReturn:
    text = f"register {name!r}: {value} ({value:#x}) is outside {low} to {high} ({low:#x} to {high:#x})"
    raise RequestInvalid(ErrorInfo("out_of_range", text))


# ---- compiling ---------------------------------------------------------------------------


def _compiled(pages: WindowPages, table: ConfigInfo) -> type[RegisterWindow]:
    """A class with a property for each register. Its objects have the same layout as all others."""
    readers: dict[str, Callable[[Any], int]] = {}
    writers: dict[str, Callable[[Any, Any], None]] = {}
    members: dict[str, Any] = {"__slots__": (), "_table": table, "__module__": __name__}
    for register in table.registers:
        offset = register.address - pages.address
        read, write = _reader(register, offset), _writer(register, offset, pages.writable)
        readers[register.name], writers[register.name] = read, write
        if register.name.isidentifier() and not hasattr(RegisterWindow, register.name):
            members[register.name] = property(read, write, doc=register.doc or None)
        for field in register.fields:
            name, mask = f"{register.name}.{field.name}", ((1 << field.width) - 1) << field.lsb
            readers[name] = _field_reader(read, mask, field.lsb)
            names = dict(field.values)
            writers[name] = _field_writer(register, name, (mask, field.lsb), names, (read, write))
    members["_readers"], members["_writers"] = MappingProxyType(readers), MappingProxyType(writers)
    members["_registers"] = MappingProxyType({r.name: r for r in table.registers})
    members["_memories"] = MappingProxyType({m.name: m for m in table.memories})
    return type(pages.module or pages.region, (RegisterWindow,), members)


def _reader(register: RegisterInfo, offset: int) -> Callable[[Any], int]:
    name, width = register.name, register.width

    def read(window: Any) -> int:
        handle = window._handle
        value: int = read32(handle, offset, width)
        if value >= 0:
            return value
        window._failed(handle)
        return window[name]  # type: ignore[no-any-return]

    def read_64(window: Any) -> int:
        handle = window._handle
        try:
            return read_wide(handle, offset, width)
        except OSError:
            window._failed(handle)
            return window[name]  # type: ignore[no-any-return]

    def refuse(_: Any) -> NoReturn:
        _no_access(name, writes=False)

    return refuse if register.access == "wo" else read if width <= 32 else read_64


def _writer(register: RegisterInfo, offset: int, writable: bool) -> Callable[[Any, Any], None]:
    name, width = register.name, register.width
    low = register.minimum or 0
    high = (1 << width) - 1 if register.maximum is None else min(register.maximum, (1 << width) - 1)

    def write(window: Any, value: Any) -> None:
        if not low <= value <= high:
            _refuse(name, value, low, high)
        handle = window._handle
        if write_plain(handle, offset, width, value) < 0:
            window._failed(handle)
            window[name] = value

    def write_and_keep(window: Any, value: Any) -> None:
        write(window, value)
        window._seen[name] = value

    def refuse(window: Any, _: Any) -> None:
        if register.access == "ro":
            _no_access(name, writes=True)
        window._only_read()

    if register.access == "ro" or not writable:
        return refuse
    return write_and_keep if any(_rest(register, 1 << f.lsb).last for f in register.fields) else write


def _rest(register: RegisterInfo, mask: int) -> Rest:
    """What a write of the bits in `mask` writes to the others."""
    fields = [(f.name, ((1 << f.width) - 1) << f.lsb, f.access or register.access) for f in register.fields]
    return rest_of((register.access, register.width), fields, mask)


def _field_reader(read: Callable[[Any], int], mask: int, lsb: int) -> Callable[[Any], int]:
    return lambda window: (read(window) & mask) >> lsb


def _field_writer(
    register: RegisterInfo,
    name: str,
    place: tuple[int, int],
    values: Mapping[str, int],
    whole: tuple[Callable[[Any], int], Callable[[Any, Any], None]],
) -> Callable[[Any, Any], None]:
    """Writes the field, and to the rest what leaves it as it is."""
    (mask, lsb), (read, write) = place, whole
    others = _rest(register, mask)
    does = {f"{register.name}.{f.name}": f.access or register.access for f in register.fields}

    def rest(window: Any) -> int:
        kept = others.ones | (read(window) & others.read if others.read else 0)
        last = window._seen.get(register.name, None if others.last else 0)
        if last is None:
            why = must_not_be_read(register.access, does.values())
            raise RequestInvalid(
                ErrorInfo("access", f"register {register.name!r} {why}: write the whole of it here first")
            )
        return int(kept | last & others.last)

    def put(window: Any, value: Any) -> None:
        if isinstance(value, str):
            if value not in values:
                there = ", ".join(values) or "none"
                raise RequestInvalid(ErrorInfo("out_of_range", f"{name!r} has no value {value!r}; there are {there}"))
            value = values[value]
        number = index(value)
        if not 0 <= number <= mask >> lsb:
            _refuse(name, number, 0, mask >> lsb)
        write(window, rest(window) | number << lsb)

    def refuse(_: Any, __: Any) -> NoReturn:
        if not KINDS[does[name]].writable:
            _no_access(name, writes=True)
        raise RequestInvalid(ErrorInfo("access", changed_too(name, register.name, others)))

    return put if KINDS[does[name]].writable and not others.changed else refuse
