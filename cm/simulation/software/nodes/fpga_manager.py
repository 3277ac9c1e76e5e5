# SPDX-License-Identifier: Apache-2.0
"""fpga_manager: firmware by name through the processor's own port, as linux-xlnx offers it in sysfs."""

from __future__ import annotations

import errno

from cm.simulation.software.errors import NodeError
from cm.simulation.software.faults import Faults
from cm.simulation.software.hardware.configuration_engine import ConfigurationEngine, LoadResult
from cm.simulation.software.nodes.attributes import AttributeNode
from cm.simulation.software.transport.root import Root
from cm.simulation.software.transport.server import Server
from cm.simulation.software.transport.session import Later

BASE = "sys/class/fpga_manager/fpga0"
NAME = "Xilinx Zynq FPGA Manager"
PARTIAL = 1  # FPGA_MGR_PARTIAL_RECONFIG; the others say how the bitstream is encrypted
SYNC_SWAPPED = b"\x66\x55\x99\xaa"


class FpgaManager:
    """``flags`` and ``firmware`` are sockets, ``name``, ``state`` and ``status`` plain files."""

    def __init__(self, root: Root, engine: ConfigurationEngine, faults: Faults, rate: float) -> None:
        self._root, self._engine, self._faults, self._rate = root, engine, faults, rate
        self._flags = 0

    def serve(self, server: Server) -> None:
        """Make the folder and listen."""
        self._root.write(f"{BASE}/name", NAME + "\n")
        self._root.write(f"{BASE}/status", "\n")
        self._state("operating")
        flags = AttributeNode(self._get_flags, self._set_flags)
        server.listen(self._root.bind(f"{BASE}/flags"), flags)
        server.listen(self._root.bind(f"{BASE}/firmware"), AttributeNode(None, self._write_firmware))

    def load(self, name: str, flags: int) -> Later:
        """Load a file of lib/firmware; the answer comes when the device has taken it."""
        later = Later()
        try:
            self._start(name, flags, later)
        except NodeError as error:
            later.finish(error)
        return later

    def _start(self, name: str, flags: int, later: Later) -> None:
        if self._engine.busy:
            raise NodeError(errno.EBUSY, "the device is being configured")
        data = self._request(name)
        self._state("write init")
        if flags & ~PARTIAL:
            # zynq-fpga without SEC_EN: "Device not secure, can't use crypted bitstreams"
            self._state("write init error")
            raise NodeError(errno.EINVAL, "the simulated device has no key")
        if SYNC_SWAPPED not in data[:4096] or len(data) % 4:
            # zynq-fpga: "Invalid bitstream, could not find a sync word. Bitstream must be a byte swapped .bin file"
            self._state("write init error")
            raise NodeError(errno.EINVAL, "no sync word: not a byte-swapped .bin")
        self._state("write")
        self._engine.start(
            memoryview(data), lambda result: self._finished(result, later), not flags & PARTIAL, self._rate
        )

    def _request(self, name: str) -> bytes:
        self._state("firmware request")
        try:
            return self._root.firmware(name)
        except NodeError:
            self._state("firmware request error")
            raise

    def _finished(self, result: LoadResult, later: Later) -> None:
        injected = self._faults.take("fpga_manager_error")
        if injected or result.status:
            self._state("write complete error" if result.errors else "write error")
            later.finish(NodeError(-result.status or errno.EIO))
            return
        self._state("operating")
        later.finish()

    def _get_flags(self) -> bytes:
        return f"{self._flags:x}\n".encode()

    def _set_flags(self, data: bytes) -> None:
        try:
            self._flags = int(data.decode("ascii").strip(), 16)
        except ValueError:
            raise NodeError(errno.EINVAL, "flags are a hexadecimal number") from None

    def _write_firmware(self, data: bytes) -> Later:
        name = data.rstrip(b"\n").decode("utf-8", "replace")
        return self.load(name, self._flags)

    def _state(self, text: str) -> None:
        self._root.write(f"{BASE}/state", text + "\n")
