# SPDX-License-Identifier: Apache-2.0
"""The simulator's own attribute ``sim/control``: commands are JSON, and so is what is read."""

from __future__ import annotations

import errno
import json
from collections.abc import Callable, Iterable
from typing import Any

from cm.simulation.software.errors import NodeError, Refused
from cm.simulation.software.faults import KINDS, target_of
from cm.simulation.software.hardware.links import Camera
from cm.simulation.software.nodes.attributes import AttributeNode
from cm.simulation.software.process.machine import Machine
from cm.simulation.software.transport.protocol import CONTROL_PATH
from cm.wire.lazy_numpy import np

Order = dict[str, Any]


class Orders:
    """Fault injection, and what the hardware alone decides: frames, interrupts."""

    def __init__(self, machine: Machine, adopt: Callable[[int], None] | None) -> None:
        """`adopt`: makes another process the board's owner; None: it was started manually."""
        self._machine, self._adopted = machine, adopt
        logic = machine.logic
        self._orders: dict[str, Callable[[Order], None]] = {
            "inject": self._inject,
            "clear": self._clear,
            "interrupt": self._interrupt,
            "pause": lambda order: self._camera(order).pause(),
            "step": lambda order: self._camera(order).step(int(order.get("frames", 1))),
            "resume": lambda order: self._camera(order).resume(),
            "reset": lambda _: machine.power_up(),
            "adopt": self._adopt,
            "trace": lambda order: logic.trace(str(order.get("folder") or "")),
            "upset": self._upset,
            "frame": self._frame,
            "register": self._register,
        }
        machine.server.listen(machine.root.bind(CONTROL_PATH), AttributeNode(self._read, self._write))

    def _read(self) -> bytes:
        return json.dumps(self._machine.state()).encode()

    def _write(self, data: bytes) -> None:
        try:
            order = json.loads(data)
            self._orders[order["do"]](order)
        except NodeError as error:
            raise Refused(error.number, str(error.strerror)) from error
        except (ValueError, KeyError, TypeError) as error:
            raise Refused(errno.EINVAL, f"the order cannot be understood: {error}") from error

    def _inject(self, order: Order) -> None:
        kind, target = str(order["kind"]), str(order.get("target") or "")
        if kind not in KINDS:
            raise NodeError(errno.EINVAL, f"no fault is called {kind}")
        if target:
            self._check_target(kind, target)
        numbers = (int(order.get("value", 0)), int(order.get("count", 1)), int(order.get("after", 0)))
        self._machine.faults.inject(kind, target, *numbers)

    def _check_target(self, kind: str, target: str) -> None:
        """Raise NodeError for a target that the board does not have: the fault would wait for ever."""
        spec, what = self._machine.fabric.spec, target_of(kind)
        if not what:
            raise NodeError(errno.EINVAL, f"{kind} has no target, so {target!r} cannot be one; a value follows ''")
        known = {
            "channel": set(self._machine.links),
            "interrupt": set(spec.interrupts),
            "register": {register.name for register in spec.registers},
        }
        if what in known and target not in known[what]:
            raise NodeError(errno.ENOENT, f"no {what} is called {target}{_there(known[what])}")

    def _clear(self, order: Order) -> None:
        self._machine.faults.clear(str(order.get("kind") or ""), str(order.get("target") or ""))
        self._machine.kick()

    def _interrupt(self, order: Order) -> None:
        name, known = str(order["name"]), self._machine.fabric.spec.interrupts
        if not self._machine.logic.interrupts.fire(name):
            if name in known:
                raise NodeError(errno.EOPNOTSUPP, f"{name} is an output of the HDL that runs: nothing else raises it")
            raise NodeError(errno.ENOENT, f"no interrupt is called {name}{_there(known)}")

    def _upset(self, order: Order) -> None:
        region, frame, bit = str(order["region"]), order.get("frame"), order.get("bit")
        if region not in self._machine.fabric.regions:
            raise NodeError(errno.ENOENT, f"no region is called {region}{_there(self._machine.fabric.regions)}")
        try:
            self._machine.upset(region, int(order.get("bits", 1)), frame, bit)
        except (KeyError, IndexError):
            where = "" if frame is None else f" in frame {frame:#010x}, or no such bit"
            raise NodeError(errno.ENODATA, f"region {region} holds no configuration{where}") from None

    def _frame(self, order: Order) -> None:
        channel = str(order["channel"])
        links = self._machine.links
        if channel not in links:
            raise NodeError(errno.ENOENT, f"no channel is called {channel}{_there(links)}")
        try:
            data = np.fromfile(str(order["file"]), np.uint8)
        except OSError as error:
            raise NodeError(error.errno or errno.EIO, f"{order['file']}: {error.strerror}") from error
        if not links[channel].offer(channel, data):
            raise NodeError(errno.EAGAIN, f"too many frames of {channel} wait already, or no module is before it")

    def _register(self, order: Order) -> None:
        name, fabric = str(order["name"]), self._machine.fabric
        cells = [cell for region in (None, *fabric.regions) if (cell := fabric.cell(name, region)) is not None]
        if not cells:
            names = {register.name for register in fabric.spec.registers}
            raise NodeError(errno.ENOENT, f"no register is called {name}{_there(names)}")
        for cell in cells:
            cell.value = int(order["value"])

    def _adopt(self, order: Order) -> None:
        if self._adopted is None:
            raise NodeError(errno.EBUSY, "this simulator was started by hand, and ends by hand")
        self._adopted(int(order["pid"]))

    def _camera(self, order: Order) -> Camera:
        cameras = {name: link.camera for name, link in self._machine.links.items() if link.camera is not None}
        if order["channel"] not in cameras:
            raise NodeError(errno.ENOENT, f"no camera is called {order['channel']}{_there(cameras)}")
        return cameras[order["channel"]]


def _there(names: Iterable[str]) -> str:
    """Which there are, for the end of a sentence."""
    found = sorted(names)
    return f"; there are {', '.join(found)}" if found else ""
