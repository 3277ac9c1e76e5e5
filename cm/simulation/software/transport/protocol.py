# SPDX-License-Identifier: Apache-2.0
"""The structures of ``kmod/uapi`` as `struct` formats: the wire of a simulated node.

Formats are little-endian without padding; ``tests/unit/simulation/test_sim_protocol.py`` compiles the headers
and compares sizes, offsets and numbers.
"""

from __future__ import annotations

import errno
import struct

from cm.simulation.software.errors import NodeError

REQUEST = struct.Struct("<II")  # cm_node_request: op, length
REPLY = struct.Struct("<IiII")  # cm_node_reply: op, error, length, flags
REG = struct.Struct("<IIQQ")  # cm_node_reg: map, width, offset, value
MIRROR = struct.Struct("<IiQ")  # cm_node_mirror: map, fd, size
BLOCK = struct.Struct("<IIQ")  # cm_node_block: map, length, offset
CONTROL_PATH = "sim/control"  # below the root: the simulator's own attribute
PAYLOAD_MAX = 65536
BLOCK_MAX = PAYLOAD_MAX - BLOCK.size

OP_OPEN = 0
OP_REG_READ = 1
OP_REG_WRITE = 2
OP_ATTR_READ = 3
OP_ATTR_WRITE = 4
OP_MKDIR = 5
OP_RMDIR = 6
OP_MIRROR = 7
OP_BLOCK_READ = 8
OP_BLOCK_WRITE = 9
OP_GRANT = 10
OFFERS_MIRROR = 1
OFFERS_BLOCKS = 2

BUFFER_ALLOC = struct.Struct("<IIQIiIIQ")  # size, flags, length, handle, fd, coherent, reserved, address
BUFFER_IMPORT = struct.Struct("<IIiIQ")  # size, flags, fd, handle, length
BUFFER_FREE = struct.Struct("<IIII")  # size, flags, handle, reserved

DMA_INFO = struct.Struct("<IIIIIIQII32s")
DMA_SUBMIT = struct.Struct("<IIIIQQQQ")  # size, flags, handle, reserved, offset, length, period, cookie
DMA_SUBMIT_VIDEO = struct.Struct("<IIIIQIIQ")  # size, flags, handle, lines, offset, line_bytes, stride, cookie
DMA_CANCEL = struct.Struct("<II")
DMA_COMPLETION = struct.Struct("<QQQQiI")  # cookie, length, timestamp_ns, sequence, status, flags

ICAP_INFO = struct.Struct("<IIIIQII")  # size, flags, word_bits, clock_hz, max_length, idcode, caps
ICAP_LOAD = struct.Struct("<IIIIQQQ")  # size, flags, handle, reserved, offset, length, cookie
ICAP_READ = struct.Struct("<IIIIQQQQQQQ")  # size, flags, handle, reserved, offset and length of three parts, cookie
ICAP_STATUS = struct.Struct("<IIIIQQQ")  # size, flags, state, errors, bytes_done, bytes_total, loads
ICAP_COMPLETION = struct.Struct("<QQQQiI")  # cookie, length, started_ns, finished_ns, status, errors

# linux/gpio.h, for one line: the fields that we use, the others skipped
GPIO_CHIP_INFO = struct.Struct("<32s32sI")  # name, label, lines
GPIO_LINE_INFO = struct.Struct("<32s32xI188x")  # name, offset
GPIO_LINE_REQUEST = struct.Struct("<I252x32sQ264xI24xi")  # offsets[0], consumer, config.flags, num_lines, fd
GPIO_LINE_CONFIG = struct.Struct("<QI20xI4xQQ216x")  # flags, num_attrs; of the first attribute: id, values, mask
GPIO_LINE_VALUES = struct.Struct("<QQ")  # bits, mask
GPIO_FLAG_OUTPUT = 1 << 3
GPIO_ATTR_OUTPUT_VALUES = 2

_WRITE, _READ = 1, 2


def ioc(direction: int, magic: int, number: int, size: int) -> int:
    """The number that ``_IOW`` (1) and ``_IOWR`` (3) make, as in asm-generic/ioctl.h."""
    return direction << 30 | size << 16 | magic << 8 | number


MAGIC = 0xC5  # of all our modules
_RW = _READ | _WRITE

DMA_IOC_INFO = ioc(_RW, MAGIC, 0, DMA_INFO.size)
DMA_IOC_ALLOC = ioc(_RW, MAGIC, 1, BUFFER_ALLOC.size)
DMA_IOC_IMPORT = ioc(_RW, MAGIC, 2, BUFFER_IMPORT.size)
DMA_IOC_FREE = ioc(_WRITE, MAGIC, 3, BUFFER_FREE.size)
DMA_IOC_SUBMIT = ioc(_WRITE, MAGIC, 4, DMA_SUBMIT.size)
DMA_IOC_SUBMIT_VIDEO = ioc(_WRITE, MAGIC, 5, DMA_SUBMIT_VIDEO.size)
DMA_IOC_CANCEL = ioc(_WRITE, MAGIC, 6, DMA_CANCEL.size)

ICAP_IOC_INFO = ioc(_RW, MAGIC, 0x20, ICAP_INFO.size)
ICAP_IOC_ALLOC = ioc(_RW, MAGIC, 0x21, BUFFER_ALLOC.size)
ICAP_IOC_IMPORT = ioc(_RW, MAGIC, 0x22, BUFFER_IMPORT.size)
ICAP_IOC_FREE = ioc(_WRITE, MAGIC, 0x23, BUFFER_FREE.size)
ICAP_IOC_LOAD = ioc(_WRITE, MAGIC, 0x24, ICAP_LOAD.size)
ICAP_IOC_STATUS = ioc(_RW, MAGIC, 0x25, ICAP_STATUS.size)
ICAP_IOC_READ = ioc(_WRITE, MAGIC, 0x26, ICAP_READ.size)

WINDOW_GRANT = struct.Struct("<IIQQIi")  # size, flags, address, length, id, fd
WINDOW_REVOKE = struct.Struct("<IIQQII")  # size, flags, address, length, id, count
WINDOW_STATE = struct.Struct("<IIQ")  # revoked, flags, length
WINDOW_EVENT = struct.Struct("<II")  # id, reason
NODE_GRANT = struct.Struct("<iIQ")  # fd, reserved, offset
WINDOW_WRITE = 1
WINDOW_RELEASED, WINDOW_REVOKED_CALL, WINDOW_REVOKED_OWNER = 0, 1, 3
WINDOW_IOC_GRANT = ioc(_RW, MAGIC, 0x40, WINDOW_GRANT.size)
WINDOW_IOC_REVOKE = ioc(_RW, MAGIC, 0x41, WINDOW_REVOKE.size)

_GPIO_MAGIC = 0xB4
GPIO_CHIP_INFO_IOCTL = ioc(_READ, _GPIO_MAGIC, 0x01, GPIO_CHIP_INFO.size)
GPIO_GET_LINE_IOCTL = ioc(_RW, _GPIO_MAGIC, 0x07, GPIO_LINE_REQUEST.size)
GPIO_GET_LINE_INFO_IOCTL = ioc(_RW, _GPIO_MAGIC, 0x05, GPIO_LINE_INFO.size)
GPIO_SET_CONFIG_IOCTL = ioc(_RW, _GPIO_MAGIC, 0x0D, GPIO_LINE_CONFIG.size)
GPIO_GET_VALUES_IOCTL = ioc(_RW, _GPIO_MAGIC, 0x0E, GPIO_LINE_VALUES.size)

MM2S, S2MM = 1, 2
TYPE_AXIDMA, TYPE_VDMA = 1, 2
CAP_CYCLIC, CAP_VIDEO, CAP_RESIDUE, CAP_SIMPLE = 1, 2, 4, 8
SUBMIT_CYCLIC = 1
COMPLETION_OVERRUN = 1

LOAD_FULL, LOAD_ENCRYPTED = 1, 2
STATE_IDLE, STATE_LOADING, STATE_ERROR = 0, 1, 2
ERR_CRC, ERR_ID, ERR_DMA, ERR_TIMEOUT, ERR_NOSYNC, ERR_PORT = 1, 2, 4, 8, 16, 32
ICAP_CAP_STATUS = 1
ICAP_CAP_READ = 4


def unpack(form: struct.Struct, payload: bytes) -> tuple[int, ...]:
    """Unpack an ioctl's structure by the rule of ``cm_buffer.h``; the fields behind ``size``.

    A shorter structure counts as padded with zeros, a longer one must be zero beyond ours.

    Raises:
        NodeError: EINVAL for a size that is not the payload's, E2BIG for unknown non-zero bytes.
    """
    if len(payload) < 8 or int.from_bytes(payload[:4], "little") != len(payload):
        raise NodeError(errno.EINVAL, "size is not the structure's")
    if len(payload) != form.size:
        if any(payload[form.size :]):
            raise NodeError(errno.E2BIG, "unknown fields are set")
        payload = payload[: form.size].ljust(form.size, b"\0")
    return form.unpack(payload)[1:]


def require_zero(*values: int) -> None:
    """Refuse unknown flags and reserved fields that are set (EINVAL)."""
    if any(values):
        raise NodeError(errno.EINVAL, "unknown flags or reserved fields are set")
