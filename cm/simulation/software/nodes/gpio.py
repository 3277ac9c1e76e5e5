# SPDX-License-Identifier: Apache-2.0
"""GPIO chips as nodes: what we use of ``linux/gpio.h``, uAPI v2. A request is for one line."""

from __future__ import annotations

import errno
import struct

from cm.simulation.software.errors import NodeError
from cm.simulation.software.faults import Faults
from cm.simulation.software.hardware.fabric import Fabric
from cm.simulation.software.hardware.gpio import Chip
from cm.simulation.software.transport import protocol
from cm.simulation.software.transport.server import Server
from cm.simulation.software.transport.session import Answer, Events, Ioctls


class GpioChipNode:
    """``/dev/gpiochipN``; a line is held by one client at a time, and keeps its value when it is released."""

    def __init__(self, chip: Chip, fabric: Fabric, faults: Faults, server: Server) -> None:
        self.chip, self.fabric, self.faults, self.server = chip, fabric, faults, server
        self.held: dict[int, str] = {}  # by which client

    def open(self, events: Events) -> GpioChipSession:  # noqa: ARG002 (there are none)
        """A new open file."""
        return GpioChipSession(self)


class GpioChipSession(Ioctls):
    """One open chip. Lines that were asked for are files of their own."""

    def __init__(self, node: GpioChipNode) -> None:
        self._node = node
        super().__init__(
            {
                protocol.GPIO_CHIP_INFO_IOCTL: self._chip,
                protocol.GPIO_GET_LINE_IOCTL: self._line,
                protocol.GPIO_GET_LINE_INFO_IOCTL: self._info,
            }
        )

    def _chip(self, payload: bytes) -> bytes:  # noqa: ARG002 - nothing is asked in it
        chip = self._node.chip
        return protocol.GPIO_CHIP_INFO.pack(chip.name.encode(), chip.label.encode(), chip.lines)

    def _info(self, payload: bytes) -> bytes:
        """The name of a line, "" where it has none; who holds it is not told."""
        _sized(protocol.GPIO_LINE_INFO, payload)
        _, place = protocol.GPIO_LINE_INFO.unpack(payload)
        chip = self._node.chip
        if place >= chip.lines:
            raise NodeError(errno.EINVAL, f"lines are 0 to {chip.lines - 1}")
        name = next((name for name, where in chip.names.items() if where == place), "")
        return protocol.GPIO_LINE_INFO.pack(name.encode(), place)

    def _line(self, payload: bytes) -> Answer:
        _sized(protocol.GPIO_LINE_REQUEST, payload)
        line, consumer, _, count, _ = protocol.GPIO_LINE_REQUEST.unpack(payload)
        if count != 1 or line >= self._node.chip.lines:
            raise NodeError(errno.EINVAL, f"one line at a time, of {self._node.chip.lines}")
        if line in self._node.held:
            raise NodeError(errno.EBUSY, f"held by {self._node.held[line]}")
        self._node.held[line] = consumer.rstrip(b"\0").decode("utf-8", "replace")
        return Answer(payload, [self._node.server.connect(_Line(self._node, line)).detach()])


class _Line:
    """The node behind a line's descriptor, which is open from the start, once."""

    def __init__(self, node: GpioChipNode, line: int) -> None:
        self._node, self._line = node, line

    def open(self, events: Events) -> _LineSession:  # noqa: ARG002 (there are none)
        return _LineSession(self._node, self._line)


class _LineSession(Ioctls):
    """One line that is held; at first its direction and value are unchanged."""

    def __init__(self, node: GpioChipNode, line: int) -> None:
        self._node, self._line = node, line
        super().__init__({protocol.GPIO_GET_VALUES_IOCTL: self._value, protocol.GPIO_SET_CONFIG_IOCTL: self._configure})

    def close(self) -> None:
        """Given back."""
        self._node.held.pop(self._line, None)

    def _value(self, payload: bytes) -> bytes:
        _sized(protocol.GPIO_LINE_VALUES, payload)
        return protocol.GPIO_LINE_VALUES.pack(self._node.fabric.lines.value(self._node.chip, self._line), 1)

    def _configure(self, payload: bytes) -> bytes:
        """Make it an output with a value; other parts of a line's configuration are not simulated."""
        _sized(protocol.GPIO_LINE_CONFIG, payload)
        flags, count, attribute, values, mask = protocol.GPIO_LINE_CONFIG.unpack(payload)
        wanted = (protocol.GPIO_FLAG_OUTPUT, 1, protocol.GPIO_ATTR_OUTPUT_VALUES, 1)
        if (flags, count, attribute, mask) != wanted:
            raise NodeError(errno.EINVAL, "only an output with a value is known here")
        node = self._node
        if not node.faults.take("gpio_stuck", f"{node.chip.label}:{self._line}"):
            node.fabric.drive_line(node.chip, self._line, values & 1)
        return payload


def _sized(form: struct.Struct, payload: bytes) -> None:
    if len(payload) != form.size:
        raise NodeError(errno.EINVAL, "size is not the structure's")
