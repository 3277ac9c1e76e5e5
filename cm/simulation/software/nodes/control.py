# SPDX-License-Identifier: Apache-2.0
"""The simulator's own attribute ``sim/control``: commands are JSON, and so is what is read."""

from __future__ import annotations

import errno
import json
from collections.abc import Callable, Iterable
from typing import Any, Protocol

from cm.simulation.software.errors import NodeError, Refused
from cm.simulation.software.faults import KINDS, Faults, target_of
from cm.simulation.software.hardware.fabric import Fabric
from cm.simulation.software.hardware.links import CameraLink, Link
from cm.simulation.software.hardware.logic import InterruptLines, Logic
from cm.simulation.software.nodes.attributes import AttributeNode
from cm.simulation.software.transport.protocol import CONTROL_PATH
from cm.simulation.software.transport.root import Root
from cm.simulation.software.transport.server import Server

Order = dict[str, Any]


class Owner(Protocol):
    """The process that the simulator belongs to."""

    def replace(self, pid: int) -> None:
        """Belong to another one; NodeError while the present owner lives."""


class Controlled(Protocol):
    """What the control node needs of the board."""

    logic: Logic
    fabric: Fabric
    faults: Faults
    links: dict[str, Link]

    @property
    def interrupts(self) -> InterruptLines:
        """The lines to the processor."""

    @property
    def parent(self) -> Owner | None:
        """None: it was started manually."""

    def upset(self, region: str, bits: int, frame: int | None, bit: int | None) -> None:
        """Turn over bits of a region's frames. Raises KeyError where it holds none."""

    def power_up(self) -> None:
        """Empty all, as power-up does."""

    def kick(self) -> None:
        """Check whether data can move."""

    def state(self) -> dict[str, object]:
        """What the board holds now."""


class ControlNode:
    """Fault injection, and what the hardware alone decides: frames, interrupts."""

    def __init__(self, machine: Controlled) -> None:
        self._machine = machine
        self._orders: dict[str, Callable[[Order], None]] = {
            "inject": self._inject,
            "clear": self._clear,
            "interrupt": self._interrupt,
            "pause": self._pause,
            "step": self._step,
            "resume": self._resume,
            "reset": self._reset,
            "adopt": self._adopt,
            "trace": self._trace,
            "mark": self._mark,
            "upset": self._upset,
            "cover": self._cover,
        }

    def serve(self, server: Server, root: Root) -> None:
        """Listen."""
        server.listen(root.bind(CONTROL_PATH), AttributeNode(self._read, self._write))

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
        self._machine.faults.inject(kind, target, int(order.get("value", 0)), int(order.get("count", 1)))

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
        if not self._machine.interrupts.fire(str(order["name"])):
            there = _there(self._machine.fabric.spec.interrupts)
            raise NodeError(errno.ENOENT, f"no interrupt is called {order['name']}{there}")

    def _pause(self, order: Order) -> None:
        self._camera(order).pause()

    def _step(self, order: Order) -> None:
        self._camera(order).step(int(order.get("frames", 1)))

    def _resume(self, order: Order) -> None:
        self._camera(order).resume()

    def _reset(self, order: Order) -> None:  # noqa: ARG002 - an order like the others
        self._machine.power_up()
        for line in self._machine.interrupts.lines:
            line.drop_pending()
        self._machine.kick()

    def _upset(self, order: Order) -> None:
        region, frame, bit = str(order["region"]), order.get("frame"), order.get("bit")
        if region not in self._machine.fabric.regions:
            raise NodeError(errno.ENOENT, f"no region is called {region}{_there(self._machine.fabric.regions)}")
        try:
            self._machine.upset(region, int(order.get("bits", 1)), frame, bit)
        except (KeyError, IndexError):
            where = "" if frame is None else f" in frame {frame:#010x}, or no such bit"
            raise NodeError(errno.ENODATA, f"region {region} holds no configuration{where}") from None

    def _trace(self, order: Order) -> None:
        self._machine.logic.trace(str(order.get("folder") or ""))

    def _mark(self, order: Order) -> None:
        self._machine.logic.mark(str(order["text"]))

    def _cover(self, order: Order) -> None:  # noqa: ARG002 - an order like the others
        self._machine.logic.cover()

    def _adopt(self, order: Order) -> None:
        if self._machine.parent is None:
            raise NodeError(errno.EBUSY, "this simulator was started by hand, and ends by hand")
        self._machine.parent.replace(int(order["pid"]))

    def _camera(self, order: Order) -> CameraLink:
        link = self._machine.links.get(str(order["channel"]))
        if not isinstance(link, CameraLink):
            there = _there(name for name, link in self._machine.links.items() if isinstance(link, CameraLink))
            raise NodeError(errno.ENOENT, f"no camera is called {order['channel']}{there}")
        return link


def _there(names: Iterable[str]) -> str:
    """Which there are, for the end of a sentence."""
    found = sorted(names)
    return f"; there are {', '.join(found)}" if found else ""
