# SPDX-License-Identifier: Apache-2.0
"""Real ROS 2 against both nodes of a board: rclpy sees and asks `cm_ros2`, and over rmw_zenoh_cpp `cm bridge ros` too.

Needs rclpy and cm_interfaces built (docs/ros2.md), sourced into the environment, with the middleware that
RMW_IMPLEMENTATION names.
"""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from typing import Any

import pytest
from manager_process import REPOSITORY, Manager, until
from manager_process import served as served_by

import cm
from cm.simulation.software import Board as SimBoard

if find_spec("rclpy") is None or find_spec("cm_interfaces") is None:
    pytest.skip("needs_rclpy: rclpy and cm_interfaces of a ROS 2 workspace", allow_module_level=True)
ZENOH = os.environ.get("RMW_IMPLEMENTATION") == "rmw_zenoh_cpp"
PATIENCE = 60.0

pytestmark = [pytest.mark.elsewhere, pytest.mark.filterwarnings("default")]  # rclpy's warnings are not ours


class Node:
    """A node of rclpy in this process, spun by a thread."""

    def __init__(self) -> None:
        import rclpy
        from rclpy.executors import MultiThreadedExecutor

        self._rclpy = rclpy
        rclpy.init()
        self.node = rclpy.create_node("tester")
        self._executor = MultiThreadedExecutor(4)
        self._executor.add_node(self.node)
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()

    def _spin(self) -> None:
        """Tests end their subscriptions while it waits for them, as `cm_ros2.node.spin` knows of its own."""
        from rclpy.executors import InvalidHandle

        while True:
            with suppress(InvalidHandle):
                return self._executor.spin()

    def close(self) -> None:
        self._executor.shutdown()
        self._thread.join(PATIENCE)
        self.node.destroy_node()
        self._rclpy.try_shutdown()

    def next(self, kind: Any, topic: str, quality: Any, fits: Callable[[Any], bool] = lambda _: True) -> Any:
        found: list[Any] = []
        arrived = threading.Event()

        def take(message: Any) -> None:
            if fits(message):
                found.append(message)
                arrived.set()

        subscription = self.node.create_subscription(kind, topic, take, quality)
        assert arrived.wait(PATIENCE), f"nothing fit on {topic}"
        self.node.destroy_subscription(subscription)
        return found[0]

    def call(self, kind: Any, name: str, request: Any) -> Any:
        client = self.node.create_client(kind, name)
        assert client.wait_for_service(PATIENCE), f"there is no service {name}"
        for _ in range(4):  # as users do: the service may not have discovered us at the first request
            done = threading.Event()
            future = client.call_async(request)
            future.add_done_callback(lambda _, done=done: done.set())
            if done.wait(PATIENCE / 4):
                self.node.destroy_client(client)
                return future.result()
        raise AssertionError(f"{name} did not answer")


@contextmanager
def lifecycle_node(manager: Manager, *parameters: str, namespace: str = "/lab") -> Iterator[None]:
    """`ros2 run cm_ros2 board`, from the sources here."""
    path = os.pathsep.join([str(REPOSITORY / "ros2" / "cm_ros2"), str(REPOSITORY), os.environ.get("PYTHONPATH", "")])
    environment = {**os.environ, "PYTHONPATH": path}
    words = [sys.executable, "-m", "cm_ros2.node", "--ros-args", "-r", "__node:=cm", "-r", f"__ns:={namespace}"]
    for parameter in parameters or (f"connect:={manager.runtime}", "write:=all"):
        words += ["-p", parameter]
    process = subprocess.Popen(words, env=environment)
    try:
        yield
    finally:
        process.terminate()
        process.wait(PATIENCE)


@contextmanager
def bridge(manager: Manager) -> Iterator[None]:
    """`cm bridge ros`."""
    import zenoh_support

    made = zenoh_support.Bridge(manager.runtime, os.environ["ROUTER"], "--namespace", "/lab")
    try:
        yield
    finally:
        made.stop()


@contextmanager
def network() -> Iterator[dict[str, str]]:
    """The environment in which ROS's nodes meet, and nobody else."""
    if not ZENOH:
        # From 102 on a domain has ports that Linux hands out by itself.
        yield {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_DOMAIN_ID": str(1 + os.getpid() % 100)}
        return
    from zenoh_support import DOMAIN, Router

    router = Router()
    try:
        endpoints = f'connect/endpoints=["tcp/{router.where}"]'
        yield {"ZENOH_CONFIG_OVERRIDE": endpoints, "ROS_DOMAIN_ID": str(DOMAIN), "ROUTER": router.where}
    finally:
        router.close()


@pytest.fixture(scope="module")
def ros() -> Iterator[Node]:
    with network() as environment:
        os.environ.update(environment)
        node = Node()
        yield node
        node.close()


@pytest.fixture(scope="module", params=[lifecycle_node, bridge][: 1 + ZENOH], ids=lambda served: served.__name__)
def served(request: pytest.FixtureRequest, shared: tuple[Manager, SimBoard], ros: Node) -> Iterator[None]:
    with request.param(shared[0]):
        until(lambda: ("cm", "/lab") in ros.node.get_node_names_and_namespaces(), PATIENCE)
        yield


def qualities() -> Any:
    from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data

    return QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL), qos_profile_sensor_data


def test_the_graph_has_the_node_with_its_topics_services_and_hashes(served: None, ros: Node, board: cm.Board) -> None:
    def topics() -> dict[str, list[str]]:
        return dict(ros.node.get_publisher_names_and_types_by_node("cm", "/lab"))

    until(lambda: "/lab/cm/camera/image_raw" in topics(), PATIENCE)  # the last of them
    assert topics()["/lab/cm/status"] == ["cm_interfaces/msg/Status"]
    services = dict(ros.node.get_service_names_and_types_by_node("cm", "/lab"))
    assert services["/lab/cm/set_mode"] == ["cm_interfaces/srv/SetMode"]
    assert services["/lab/cm/get_parameters"] == ["rcl_interfaces/srv/GetParameters"]
    (info,) = ros.node.get_publishers_info_by_topic("/lab/cm/status")
    assert (info.node_name, info.node_namespace) == ("cm", "/lab")
    from cm.networks.rmw_zenoh.interfaces import type_hash

    assert str(info.topic_type_hash) == type_hash("cm_interfaces/msg/Status")


def test_our_hashes_are_those_of_rosidl(ros: Node) -> None:
    from cm_interfaces.msg import Configuration, Data, RegisterBank, Status
    from sensor_msgs.msg import CameraInfo

    from cm.networks.rmw_zenoh.interfaces import type_hash

    for kind in (Status, Configuration, RegisterBank, Data, CameraInfo):
        name = f"{kind.__module__.split('.')[0]}/msg/{kind.__name__}"
        publisher = ros.node.create_publisher(kind, f"/hash_of_{kind.__name__}", 1)
        topic = f"/hash_of_{kind.__name__}"
        until(lambda topic=topic: ros.node.get_publishers_info_by_topic(topic), PATIENCE)
        assert str(ros.node.get_publishers_info_by_topic(topic)[0].topic_type_hash) == type_hash(name)
        ros.node.destroy_publisher(publisher)


def test_a_late_subscriber_gets_the_status(served: None, ros: Node, board: cm.Board) -> None:
    from cm_interfaces.msg import Status

    latched, _ = qualities()
    status = ros.next(Status, "/lab/cm/status", latched, lambda s: s.mode == "default")
    assert (status.config_name, status.pr_mode, status.regions[0].name) == ("camera", Status.PR_MODE_IDLE, "prr0")


def test_pictures_come(served: None, ros: Node, board: cm.Board) -> None:
    from sensor_msgs.msg import CameraInfo, Image

    _, sensor = qualities()
    image = ros.next(Image, "/lab/cm/camera/image_raw", sensor)
    assert (image.encoding, image.height, image.width, len(image.data)) == ("mono8", 480, 640, 480 * 640)
    assert len(set(bytes(image.data))) > 10
    assert ros.next(CameraInfo, "/lab/cm/camera/camera_info", sensor).width == 640


def test_pictures_go_through_the_accelerator(served: None, ros: Node, board: cm.Board) -> None:
    from sensor_msgs.msg import Image

    board.mode = "loopback"
    image = Image(height=480, width=640, encoding="mono8", step=640)
    image.data.frombytes(bytes(range(256)) * (480 * 640 // 256))
    publisher = ros.node.create_publisher(Image, "/lab/cm/to_pl/write", 2)
    timer = ros.node.create_timer(0.2, lambda: publisher.publish(image))
    back = ros.next(Image, "/lab/cm/from_pl/image_raw", qualities()[1])
    assert back.data == image.data
    ros.node.destroy_timer(timer)
    ros.node.destroy_publisher(publisher)


def test_services_answer(served: None, ros: Node, board: cm.Board) -> None:
    from cm_interfaces.msg import RegisterWrite
    from cm_interfaces.srv import Plan, SetMode, WriteRegisters

    assert ros.call(SetMode, "/lab/cm/set_mode", SetMode.Request(mode="edge_detection")).success
    assert board.mode == "edge_detection"
    assert ros.call(SetMode, "/lab/cm/set_mode", SetMode.Request(mode="x")).code == "unknown_mode"
    assert ros.call(Plan, "/lab/cm/plan", Plan.Request(mode="default")).steps
    request = WriteRegisters.Request(writes=[RegisterWrite(name="focus", value=6)])
    assert ros.call(WriteRegisters, "/lab/cm/write_registers", request).bank.registers[0].value == 6
    assert board.registers["focus"] == 6


def test_registers_are_parameters(served: None, ros: Node, board: cm.Board) -> None:
    from rcl_interfaces.srv import DescribeParameters, SetParameters
    from rclpy.parameter import Parameter

    parameter = Parameter("registers.focus", value=9).to_parameter_msg()
    done = ros.call(SetParameters, "/lab/cm/set_parameters", SetParameters.Request(parameters=[parameter]))
    assert done.results[0].successful
    assert board.registers["focus"] == 9
    request = DescribeParameters.Request(names=["registers.focus"])
    described = ros.call(DescribeParameters, "/lab/cm/describe_parameters", request).descriptors[0]
    assert described.integer_range[0].to_value == 15


def test_the_action_has_a_result(served: None, ros: Node, board: cm.Board) -> None:
    from cm_interfaces.action import ChangeMode
    from rclpy.action import ActionClient

    client = ActionClient(ros.node, ChangeMode, "/lab/cm/change_mode")
    assert client.wait_for_server(PATIENCE)
    goal = _done(client.send_goal_async(ChangeMode.Goal(mode="colorise")))
    assert goal.accepted
    result = _done(goal.get_result_async())
    assert (result.status, result.result.success) == (4, True)
    assert board.mode == "colorise"


def test_a_board_without_ros_is_served_over_tcp_and_observed_unless_told_otherwise(ros: Node) -> None:
    """`connect:=tcp://board`, in another namespace, without `write`."""
    from cm_interfaces.msg import Status
    from cm_interfaces.srv import SetMode
    from sensor_msgs.msg import Image

    latched, sensor = qualities()
    with served_by(arguments=("--listen", "tcp://127.0.0.1:0", "--insecure")) as (manager, _), manager.connected() as b:
        b.load("camera")
        with lifecycle_node(manager, f"connect:={manager.tcp()}", namespace="/far"):
            assert ros.next(Status, "/far/cm/status", latched, lambda s: s.mode == "default").config_name == "camera"
            assert ros.next(Image, "/far/cm/camera/image_raw", sensor).width == 640
            answer = ros.call(SetMode, "/far/cm/set_mode", SetMode.Request(mode="colorise"))
        assert (answer.code, b.mode) == ("forbidden", "default")


def _done(future: Any) -> Any:
    done = threading.Event()
    future.add_done_callback(lambda _: done.set())
    assert done.wait(PATIENCE)
    return future.result()
