# SPDX-License-Identifier: Apache-2.0
"""The uapi's structures as messages to a simulated board: each is answered, with an errno where it is refused.

A piece is the message as it travels; the first byte of the input says to which node. A memfd comes with every message
whose operation takes one.
"""

from __future__ import annotations

import logging
import os
import socket
import struct
import tempfile
import threading
from contextlib import ExitStack
from pathlib import Path

from pieces import join, split

from cm.loop import Loop
from cm.schema import load
from cm.simulation.software.hardware.board_spec import BoardSpec
from cm.simulation.software.hardware.logic import Options
from cm.simulation.software.hardware.models import Models
from cm.simulation.software.process.machine import Machine
from cm.simulation.software.transport import protocol as p
from cm.simulation.software.transport.root import Root

PACKAGES = ("cm.simulation.software.nodes", "cm.simulation.software.transport", "cm.simulation.software.hardware")
MAX_LENGTH = 4096

_CAMERA = Path(__file__).resolve().parents[3] / "cm" / "data" / "camera" / "camera.yaml"
_NODES = ("dev/uio0", "dev/cm_dma/camera", "dev/cm_icap0", "dev/gpiochip0", "sys/class/fpga_manager/fpga0/firmware")
_IMPORTS = {p.DMA_IOC_IMPORT & 0xFFFF, p.ICAP_IOC_IMPORT & 0xFFFF}
_HUNG = 60.0  # seconds
_DESCRIPTORS = 200  # a board and a few connections that end need fewer, however many inputs there were


class _Complaints(logging.Handler):
    """What the board calls a failure of its own is one."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.first: logging.LogRecord | None = None

    def emit(self, record: logging.LogRecord) -> None:
        self.first = self.first or record


class _Board:
    def __init__(self) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="cm-fuzz-")
        self.root = Path(self._folder.name)
        self.complaints = _Complaints()
        logging.getLogger("cm.simulation.software").addHandler(self.complaints)
        logging.getLogger("cm.simulation.software").propagate = False
        loop = Loop()
        options = Options(photos=None, icap_rate=0, pcap_rate=0, memory=1 << 22)
        machine = Machine(loop, Root(self.root), BoardSpec.from_configs([load(_CAMERA)]), Models.standard(), options)
        machine.serve()
        self.thread = threading.Thread(target=loop.run, daemon=True)
        self.thread.start()

    def open(self, node: str) -> socket.socket:
        sock = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        sock.settimeout(_HUNG)
        sock.connect(str(self.root / node))
        return sock


_BOARD = _Board()


def _message(op: int, body: bytes = b"") -> bytes:
    return p.REQUEST.pack(op, len(body)) + body


def _sized(form: struct.Struct, *fields: object) -> bytes:
    return form.pack(form.size, *fields)


def seeds() -> list[bytes]:
    uio = [
        _message(p.OP_REG_WRITE, p.REG.pack(0, 32, 0x10, 5)),
        _message(p.OP_REG_READ, p.REG.pack(0, 32, 0x10, 0)),
        _message(p.OP_BLOCK_WRITE, p.BLOCK.pack(0, 8, 0) + bytes(8)),
        _message(p.OP_BLOCK_READ, p.BLOCK.pack(0, 8, 0)),
        _message(p.OP_MIRROR, p.MIRROR.pack(0, -1, 0)),
    ]
    dma = [
        _message(p.DMA_IOC_INFO, bytes([p.DMA_INFO.size]) + bytes(p.DMA_INFO.size - 1)),
        _message(p.DMA_IOC_ALLOC, _sized(p.BUFFER_ALLOC, 0, 4096, 0, -1, 0, 0, 0)),
        _message(p.DMA_IOC_IMPORT, _sized(p.BUFFER_IMPORT, 0, -1, 0, 0)),
        _message(p.DMA_IOC_SUBMIT, _sized(p.DMA_SUBMIT, 0, 1, 0, 0, 4096, 0, 7)),
        _message(p.DMA_IOC_SUBMIT_VIDEO, _sized(p.DMA_SUBMIT_VIDEO, 0, 1, 4, 0, 64, 64, 8)),
        _message(p.DMA_IOC_CANCEL, _sized(p.DMA_CANCEL, 0)),
        _message(p.DMA_IOC_FREE, _sized(p.BUFFER_FREE, 0, 1, 0)),
    ]
    icap = [
        _message(p.ICAP_IOC_INFO, bytes([p.ICAP_INFO.size]) + bytes(p.ICAP_INFO.size - 1)),
        _message(p.ICAP_IOC_ALLOC, _sized(p.BUFFER_ALLOC, 0, 4096, 0, -1, 0, 0, 0)),
        _message(p.ICAP_IOC_LOAD, _sized(p.ICAP_LOAD, p.LOAD_FULL, 1, 0, 0, 256, 3)),
        _message(p.ICAP_IOC_STATUS, bytes([p.ICAP_STATUS.size]) + bytes(p.ICAP_STATUS.size - 1)),
    ]
    gpio = [
        _message(p.GPIO_CHIP_INFO_IOCTL, bytes(p.GPIO_CHIP_INFO.size)),
        _message(p.GPIO_GET_LINE_IOCTL, p.GPIO_LINE_REQUEST.pack(3, b"me", p.GPIO_FLAG_OUTPUT, 1, -1)),
    ]
    attribute = [_message(p.OP_ATTR_WRITE, b"design.bin\n"), _message(p.OP_ATTR_READ)]
    return [bytes([index]) + join(of) for index, of in enumerate((uio, dma, icap, gpio, attribute))]


def one(data: bytes) -> None:
    node = _NODES[data[0] % len(_NODES)] if data else _NODES[0]
    with ExitStack() as stack:
        sock = stack.enter_context(_BOARD.open(node))
        _answer(sock)
        for message in split(data[1:]):
            if message:  # an empty one ends a connection of this kind
                _send(sock, message)
                _answer(sock)
    with _BOARD.open("dev/uio0") as sock:  # served after all that was before
        _answer(sock)
        sock.sendall(_message(p.OP_REG_READ, p.REG.pack(0, 32, 0, 0)))
        _answer(sock)
    assert _BOARD.thread.is_alive()
    complaint = _BOARD.complaints.first
    assert complaint is None, complaint.getMessage()
    assert len(list(Path("/proc/self/fd").iterdir())) < _DESCRIPTORS


def _send(sock: socket.socket, message: bytes) -> None:
    fds = []
    if int.from_bytes(message[:4], "little") & 0xFFFF in _IMPORTS:
        fds = [os.memfd_create("fuzz", os.MFD_ALLOW_SEALING)]
        os.ftruncate(fds[0], 4096)
    try:
        socket.send_fds(sock, [message], fds)
    finally:
        for fd in fds:
            os.close(fd)


def _answer(sock: socket.socket) -> None:
    reply, fds, _, _ = socket.recv_fds(sock, 1 << 17, 8)
    for fd in fds:
        os.close(fd)
    assert len(reply) >= p.REPLY.size
