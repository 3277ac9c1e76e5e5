# SPDX-License-Identifier: Apache-2.0
"""The other node of ``make demo-ros``, without code of ours: rclpy's, or zenoh_ros2_sdk's where there is no ROS.

It does what lines on its standard input say, and answers each with a line:

    status TOPIC             the latched status
    picture TOPIC FILE N     writes the Nth picture that comes as PNM
    relay FROM TO            sends each picture on, from now on
"""

from __future__ import annotations

import os
import queue
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

IMAGE, STATUS = "sensor_msgs/msg/Image", "cm_interfaces/msg/Status"
_PATIENCE = 60.0  # seconds, on a loaded machine
_LATCHED, _SENSOR_DATA = ":1:,1:,:,:,,", "2::,5:,:,:,,"  # quality of service, as rmw_zenoh writes it


class Node(Protocol):
    """Either of them."""

    def listen(self, topic: str, kind: str, take: Callable[[Any], None]) -> Callable[[], None]:
        """Subscribe: latched to a status, as sensor data to pictures; ends by what it returns."""

    def pictures_to(self, topic: str) -> Callable[[Any], None]:
        """Publish pictures."""


class Rclpy:
    """A node of rclpy, spun by a thread."""

    def __init__(self) -> None:
        import rclpy

        rclpy.init()
        self._node = rclpy.create_node("viewer")
        threading.Thread(target=rclpy.spin, args=(self._node,), daemon=True).start()

    def listen(self, topic: str, kind: str, take: Callable[[Any], None]) -> Callable[[], None]:
        """Subscribe."""
        from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data

        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        quality = latched if kind == STATUS else qos_profile_sensor_data
        made = self._node.create_subscription(_class(kind), topic, take, quality)
        return lambda: self._node.destroy_subscription(made)

    def pictures_to(self, topic: str) -> Callable[[Any], None]:
        """Publish pictures."""
        publish: Callable[[Any], None] = self._node.create_publisher(_class(IMAGE), topic, 2).publish
        return publish


def _class(kind: str) -> Any:
    from importlib import import_module

    package, _, own = kind.split("/")
    return getattr(import_module(f"{package}.msg"), own)


class Sdk:
    """zenoh_ros2_sdk, told the interfaces, so that it fetches none; of ours it gets nothing else."""

    def __init__(self, router: str) -> None:
        import zenoh_ros2_sdk

        from cm.networks.rmw_zenoh.interfaces import STANDARD

        host, _, port = router.rpartition(":")
        self._sdk = zenoh_ros2_sdk
        self._place = {"domain_id": 0, "router_ip": host, "router_port": int(port)}
        self._session = zenoh_ros2_sdk.ZenohSession.get_instance(host, int(port))
        folder = Path(__file__).resolve().parent / "cm_interfaces" / "msg"
        self._texts = {
            f"cm_interfaces/msg/{name}": (folder / f"{name}.msg").read_text() for name in ("Region", "Status")
        }
        self._texts |= {name: STANDARD[name] for name in ("builtin_interfaces/msg/Time", "std_msgs/msg/Header", IMAGE)}
        for name, text in sorted(self._texts.items(), key=lambda one: one[0] == STATUS):  # parts before wholes
            self._session.register_message_type(text, name)

    def listen(self, topic: str, kind: str, take: Callable[[Any], None]) -> Callable[[], None]:
        """Subscribe."""

        class Subscriber(self._sdk.ROS2Subscriber):  # type: ignore[misc, name-defined]
            """It looks for what was sent before under topics without a / inside only."""

            def _discover_publishers(self) -> list[str]:
                tokens = self.session_mgr.liveliness.get("@ros2_lv/0/*/*/*/MP/**")
                parts = [str(reply.ok.key_expr).split("/") for reply in tokens]
                return list({part[2] for part in parts if part[9] == topic.replace("/", "%")})

        quality = _LATCHED if kind == STATUS else _SENSOR_DATA
        made = Subscriber(topic, kind, take, **self._kind(kind), qos=quality, **self._place)
        return made.close  # type: ignore[no-any-return]

    def pictures_to(self, topic: str) -> Callable[[Any], None]:
        """Publish pictures."""
        publisher = self._sdk.ROS2Publisher(topic, IMAGE, **self._kind(IMAGE), **self._place)
        names = ("header", "height", "width", "encoding", "is_bigendian", "step", "data")
        return lambda image: publisher.publish(**{name: getattr(image, name) for name in names})

    def _kind(self, kind: str) -> dict[str, str]:
        from cm.networks.rmw_zenoh.interfaces import type_hash

        return {"msg_definition": self._texts[kind], "type_hash": type_hash(kind)}


def status(node: Node, topic: str) -> str:
    """What the board tells who comes late."""
    came = _nth(node, topic, STATUS, 1)
    return f"{came.config_name}/{came.mode}, {', '.join(f'{r.name}: {r.module}' for r in came.regions)}"


def picture(node: Node, topic: str, file: str, number: str) -> str:
    """Write it as it came."""
    image = _nth(node, topic, IMAGE, int(number))
    form = {"mono8": "P5", "rgb8": "P6"}[image.encoding]
    Path(file).write_bytes(f"{form} {image.width} {image.height} 255\n".encode() + bytes(image.data))
    return f"{image.encoding} {image.width}x{image.height}"


def _nth(node: Node, topic: str, kind: str, number: int) -> Any:
    came: queue.Queue[Any] = queue.Queue()
    end = node.listen(topic, kind, came.put)
    try:
        return [came.get(timeout=_PATIENCE) for _ in range(number)][-1]
    finally:
        end()


def relay(node: Node, source: str, target: str) -> str:
    """Until the process ends."""
    node.listen(source, IMAGE, node.pictures_to(target))
    return f"{source} to {target}"


def main(router: str = "") -> None:
    """Serve; `router`: HOST:PORT of zenoh's, for the node without ROS."""
    node: Node = Sdk(router) if router else Rclpy()
    for line in sys.stdin:
        command, *words = line.split()
        print({"status": status, "picture": picture, "relay": relay}[command](node, *words), flush=True)
    os._exit(0)  # whatever the threads of the node's library are doing


if __name__ == "__main__":
    main(*sys.argv[1:])
