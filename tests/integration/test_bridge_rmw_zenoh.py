# SPDX-License-Identifier: Apache-2.0
"""A board as a ROS 2 node over zenoh: what zenoh_ros2_sdk, an independent implementation, sees and asks of it."""

from __future__ import annotations

import itertools
import json
import os
import queue
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from manager_process import REPOSITORY, Manager, until

import cm
from cm.errors import InvalidRequest
from cm.simulation.software import Board as SimBoard
from cm.tools.demo.boards import free_ports

pytest.importorskip("zenoh")
pytest.importorskip("xxhash")

from zenoh_support import DOMAIN, PATIENCE, Bridge, Peer, Router

from cm.networks.rmw_zenoh.interfaces import STANDARD, type_hash
from cm.networks.ros.transport import EVENTS, LATCHED, Qos

pytestmark = pytest.mark.networks
IMAGE = "sensor_msgs/msg/Image"


@pytest.fixture(scope="module")
def router() -> Iterator[Router]:
    made = Router()
    yield made
    made.close()


@pytest.fixture(scope="module")
def peer(router: Router) -> Iterator[Peer]:
    made = Peer(router.where)
    yield made
    made.close()


@pytest.fixture(scope="module")
def bridge(shared: tuple[Manager, SimBoard], router: Router) -> Iterator[Bridge]:
    """The shared manager as the node /lab/cm."""
    made = Bridge(shared[0].runtime, router.where, "--namespace", "/lab", direct=True)
    yield made
    status, said = made.stop()
    assert status == 0, said
    assert "Traceback" not in said


class Sdk:
    """zenoh_ros2_sdk, told all interfaces, so that it fetches none."""

    def __init__(self, router: Router) -> None:
        import zenoh_ros2_sdk
        from zenoh_ros2_sdk import ZenohSession

        self.sdk = zenoh_ros2_sdk
        self.place: dict[str, Any] = {"domain_id": DOMAIN, "router_ip": "127.0.0.1", "router_port": router.port}
        session = ZenohSession.get_instance("127.0.0.1", router.port)
        for name in ("builtin_interfaces/msg/Time", "std_msgs/msg/Header"):
            session.register_message_type(STANDARD[name], name)
        folder = REPOSITORY / "ros2" / "cm_interfaces" / "msg"
        for name in ("Region", "Status", "RegisterField", "Register", "RegisterBank", "PlanStep"):
            session.register_message_type((folder / f"{name}.msg").read_text(), f"cm_interfaces/msg/{name}")

    def told(self, look: str, name: str) -> Any:
        """What it finds under a name. It asks once, and zenoh's answer may lack what another link would have added."""
        return until(lambda: dict(getattr(self.sdk, look)(**self.place)).get(name), PATIENCE)

    def publisher_of(self, topic: str) -> Any:
        """Its endpoint, as shown by `ros2 topic info --verbose`."""
        return until(lambda: getattr(self._info(topic), "publishers", None), PATIENCE)[0]

    def _info(self, topic: str) -> Any:
        return self.sdk.get_topic_info(topic, verbose=True, **self.place)

    def listening(self, topic: str, kind: str, definition: str, qos: str) -> tuple[Any, queue.Queue[Any]]:
        """A subscription; for earlier publications the SDK finds no topic with a / inside, so the test helps."""
        place = self.place

        class Subscriber(self.sdk.ROS2Subscriber):  # type: ignore[misc, name-defined]
            def _discover_publishers(self) -> list[str]:
                tokens = self.session_mgr.liveliness.get(f"@ros2_lv/{place['domain_id']}/*/*/*/MP/**")
                parts = [str(reply.ok.key_expr).split("/") for reply in tokens]
                return list({part[2] for part in parts if part[9] == topic.replace("/", "%")})

        found: queue.Queue[Any] = queue.Queue()
        made = Subscriber(
            topic, kind, found.put, msg_definition=definition, type_hash=type_hash(kind), qos=qos, **self.place
        )
        return made, found

    def client(self, name: str, kind: str) -> Any:
        path: Path = REPOSITORY / "ros2" / "cm_interfaces" / "srv" / f"{kind.rpartition('/')[2]}.srv"
        asked, replied = re.sub(r"^(?=[A-Z]\w+\[\] )", "cm_interfaces/", path.read_text(), flags=re.MULTILINE).split(
            "---\n"
        )
        return self.sdk.ROS2ServiceClient(
            name, kind, asked, replied, type_hash=type_hash(kind), timeout=PATIENCE, **self.place
        )


@pytest.fixture(scope="module")
def sdk(router: Router, bridge: Bridge) -> Iterator[Sdk]:
    pytest.importorskip("zenoh_ros2_sdk")
    made = Sdk(router)
    yield made
    made.sdk.ZenohSession.get_instance().close()


def test_the_graph_of_others_has_topics_services_hashes_and_quality(bridge: Bridge, sdk: Sdk, board: cm.Board) -> None:
    topics, services = "get_topic_names_and_types", "get_service_names_and_types"
    assert sdk.told(topics, "/lab/cm/camera/image_raw") == [IMAGE]
    assert sdk.told(topics, "/lab/cm/status") == ["cm_interfaces/msg/Status"]
    assert sdk.told(services, "/lab/cm/set_mode") == ["cm_interfaces/srv/SetMode"]
    assert sdk.told(services, "/lab/cm/get_parameters") == ["rcl_interfaces/srv/GetParameters"]
    status = sdk.publisher_of("/lab/cm/status")
    assert (status.node_name.strip("/"), status.node_namespace) == ("cm", "/lab")
    assert status.type_hash == type_hash("cm_interfaces/msg/Status")
    quality = sdk.sdk.qos.QosProfile.decode(status.qos)
    assert (quality.durability.name, quality.history_depth) == ("TRANSIENT_LOCAL", 1)


def test_a_late_subscriber_of_another_implementation_gets_the_latched_status(
    bridge: Bridge, sdk: Sdk, board: cm.Board
) -> None:
    definition = (REPOSITORY / "ros2" / "cm_interfaces" / "msg" / "Status.msg").read_text()
    came: list[Any] = []

    def late() -> bool:  # it asks for earlier publications only once, when it is made
        made, found = sdk.listening("/lab/cm/status", "cm_interfaces/msg/Status", definition, ":1:,1:,:,:,,")
        made.close()
        while not found.empty():
            came.append(found.get())
        return bool(came) and (came[-1].mode, came[-1].pr_mode) == ("default", "idle")

    until(late, PATIENCE)
    assert (came[-1].config_name, came[-1].regions[0].name) == ("camera", "prr0")


def test_others_get_pictures_while_they_listen(bridge: Bridge, sdk: Sdk, board: cm.Board) -> None:
    def is_open() -> bool:
        return next(stream for stream in board.status.streams if stream.name == "camera").open

    until(lambda: not is_open(), PATIENCE)
    made, found = sdk.listening("/lab/cm/camera/image_raw", IMAGE, STANDARD[IMAGE], "2::,5:,:,:,,")
    image = found.get(timeout=PATIENCE)
    assert is_open()
    assert (image.encoding, image.height, image.width, image.step) == ("mono8", 480, 640, 640)
    assert len(set(image.data.tolist())) > 10
    made.close()
    until(lambda: not is_open(), PATIENCE)


def test_others_send_pictures_through_the_accelerator(bridge: Bridge, sdk: Sdk, peer: Peer, board: cm.Board) -> None:
    board.mode = "loopback"
    picture = np.random.default_rng(5).integers(0, 255, 480 * 640, np.uint8)
    publisher = sdk.sdk.ROS2Publisher(
        "/lab/cm/to_pl/write", IMAGE, msg_definition=STANDARD[IMAGE], type_hash=type_hash(IMAGE), **sdk.place
    )
    header = peer_header(sdk)
    fields = {"header": header, "height": 480, "width": 640, "is_bigendian": 0, "step": 640, "data": picture}
    with peer.listening("/lab/cm/from_pl/image_raw", IMAGE, Qos(5)) as back:

        def came() -> bool:  # matched on one side does not mean matched on the other
            publisher.publish(encoding="mono8", **fields)
            return not back.empty()

        until(came, PATIENCE)
        assert bytes(back.get()["data"]) == picture.tobytes()
        publisher.publish(encoding="rgb8", **fields)  # refused, logged
    publisher.close()


def peer_header(sdk: Sdk) -> Any:
    types = sdk.sdk.ZenohSession.get_instance().store.types
    return types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](1, 2), "eye")


def test_others_call_services_and_get_reasons_for_refusals(bridge: Bridge, sdk: Sdk, board: cm.Board) -> None:
    set_mode = sdk.client("/lab/cm/set_mode", "cm_interfaces/srv/SetMode")
    assert set_mode.call(mode="edge_detection", lease="").success
    assert board.mode == "edge_detection"
    assert set_mode.call(mode="nowhere", lease="").code == "unknown_mode"
    set_mode.close()
    plan = sdk.client("/lab/cm/plan", "cm_interfaces/srv/Plan").call(config_name="", mode="default")
    assert plan.success
    assert {step.kind for step in plan.steps} >= {"load"}


def test_registers_are_parameters_and_their_writers_are_reported(bridge: Bridge, peer: Peer, board: cm.Board) -> None:
    def call(name: str, kind: str, **request: Any) -> dict[str, Any]:
        return peer.call(f"/lab/cm/{name}", f"rcl_interfaces/srv/{kind}", **request)

    board.load("camera", mode="default")
    with peer.listening("/parameter_events", "rcl_interfaces/msg/ParameterEvent", EVENTS) as events:
        value = itertools.count()

        def heard() -> bool:
            good = {"name": "registers.focus", "value": {"type": 2, "integer_value": next(value) % 8 + 4}}
            (done,) = call("set_parameters", "SetParameters", parameters=[good])["results"]
            return done["successful"] and not events.empty()

        until(heard, PATIENCE)
        assert events.get()["changed_parameters"][0]["name"] == "registers.focus"
    (held,) = call("get_parameters", "GetParameters", names=["registers.focus"])["values"]
    assert held["integer_value"] == board.registers["focus"]
    bad = {"name": "registers.focus", "value": {"type": 2, "integer_value": 16}}
    assert "15" in call("set_parameters", "SetParameters", parameters=[bad])["results"][0]["reason"]


def test_the_action_tells_its_progress_and_is_cancelled(
    own: tuple[Manager, SimBoard], peer: Peer, router: Router
) -> None:
    manager, sim = own
    with manager.connected() as board:
        board.load("camera")
        bridge = Bridge(manager.runtime, router.where, "--name", "second")
        action, own_type = "/second/change_mode/_action", "cm_interfaces/action/ChangeMode"

        def call(name: str, kind: str, **request: Any) -> dict[str, Any]:
            return peer.call(f"{action}/{name}", kind, **request)

        first = {"uuid": bytes(range(16))}
        with peer.listening(f"{action}/feedback", f"{own_type}_FeedbackMessage", EVENTS) as feedback:
            assert call("send_goal", f"{own_type}_SendGoal", goal_id=first, goal={"mode": "colorise"})["accepted"]
            done = call("get_result", f"{own_type}_GetResult", goal_id=first)
            assert (done["status"], done["result"]["success"]) == (4, True)
            assert feedback.get(timeout=PATIENCE)["goal_id"]["uuid"] == first["uuid"]
        code = 3
        while code == 3:  # the goal had ended before it could be cancelled
            goal, before = {"uuid": os.urandom(16)}, board.status.last_change
            sim.control.inject("icap_hang", count=1)
            assert call("send_goal", f"{own_type}_SendGoal", goal_id=goal, goal={"mode": "edge_detection"})["accepted"]
            until(lambda last=before: board.status.fpga_busy or board.status.last_change != last, PATIENCE)
            code = call("cancel_goal", "action_msgs/srv/CancelGoal", goal_info={"goal_id": goal})["return_code"]
            ended = call("get_result", f"{own_type}_GetResult", goal_id=goal)["status"]
        assert (code, ended, board.mode) == (0, 5, "colorise")
        status, said = bridge.stop()
        assert status == 0, said


def test_a_node_that_was_not_told_to_write_observes(own: tuple[Manager, SimBoard], peer: Peer, router: Router) -> None:
    """Nothing that another node asks reaches the board; it is told what would let it through."""
    with own[0].connected() as board:
        board.load("camera")
        board.mode = "loopback"
        before = (board.mode, board.registers["focus"], board.status.last_change)
        bridge = Bridge(own[0].runtime, router.where, "--name", "fourth", "--write", "")
        ours, theirs = "cm_interfaces/srv/", "rcl_interfaces/srv/"
        write = {"writes": [{"name": "focus", "value": 7}]}
        focus = {"name": "registers.focus", "value": {"type": 2, "integer_value": 7}}
        until(lambda: peer.call("/fourth/list_parameters", f"{theirs}ListParameters")["result"]["names"], PATIENCE)
        refused = [
            peer.call("/fourth/set_mode", f"{ours}SetMode", mode="default"),
            peer.call("/fourth/load_config", f"{ours}LoadConfig", config_name="camera"),
            peer.call("/fourth/write_registers", f"{ours}WriteRegisters", **write),
        ]
        assert [(one["code"], one["message"][-11:]) for one in refused] == [
            ("forbidden", "write modes"), ("forbidden", "write modes"), ("forbidden", "e registers")
        ]  # fmt: skip
        (result,) = peer.call("/fourth/set_parameters", f"{theirs}SetParameters", parameters=[focus])["results"]
        assert (result["successful"], "write registers" in result["reason"]) == (False, True)
        described = peer.call("/fourth/describe_parameters", f"{theirs}DescribeParameters", names=["registers.focus"])
        assert described["descriptors"][0]["read_only"]
        action, kind, goal = "/fourth/change_mode/_action", "cm_interfaces/action/ChangeMode", {"uuid": bytes(16)}
        peer.call(f"{action}/send_goal", f"{kind}_SendGoal", goal_id=goal, goal={"mode": "default"})
        ended = peer.call(f"{action}/get_result", f"{kind}_GetResult", goal_id=goal)
        assert (ended["status"], ended["result"]["code"]) == (6, "forbidden")
        publisher = peer.transport.publisher("/fourth/to_pl/write", IMAGE, EVENTS)
        seen = peer.next("/fourth/configuration", "cm_interfaces/msg/Configuration", LATCHED)
        assert (seen["writable_streams"], publisher.listeners()) == (["to_pl"], 0)
        assert peer.call("/fourth/plan", f"{ours}Plan", mode="default")["success"]
        assert (board.mode, board.registers["focus"], board.status.last_change) == before
        publisher.close()
        assert bridge.stop()[0] == 0


def test_the_router_of_the_documentation_lets_viewers_see_and_operators_change(
    shared: tuple[Manager, SimBoard], board: cm.Board, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = (REPOSITORY / "ros2" / "cm_ros2" / "config" / "zenoh_access.json5").read_text()
    port, users = free_ports(), tmp_path / "users"
    users.write_text("".join(f"{name}:{name[0]}-secret\n" for name in ("board", "operator", "viewer")))
    file = tmp_path / "router.json5"
    file.write_text(text.replace("0.0.0.0:7447", f"127.0.0.1:{port}").replace('"users"', json.dumps(str(users))))

    def as_user(name: str, password: str = "") -> None:
        said = {"user": name, "password": password or f"{name[0]}-secret"}
        pairs = [f'transport/auth/usrpwd/{key}="{value}"' for key, value in said.items()]
        monkeypatch.setenv("ZENOH_CONFIG_OVERRIDE", ";".join(pairs))

    set_mode, plan = ("/door/set_mode", "cm_interfaces/srv/SetMode"), ("/door/plan", "cm_interfaces/srv/Plan")
    file.write_text(file.read_text().replace("*/cm/", "*/door/"))
    import zenoh

    with zenoh.open(zenoh.Config.from_file(str(file))):
        as_user("board")
        bridge = Bridge(shared[0].runtime, f"127.0.0.1:{port}", "--name", "door")
        try:
            as_user("viewer")
            viewer = Peer(f"127.0.0.1:{port}")
            assert viewer.call(*plan, mode="colorise")["success"]
            assert viewer.next("/door/status", "cm_interfaces/msg/Status", LATCHED)["config_name"] == "camera"
            tokens = viewer.session.liveliness().get(f"@ros2_lv/{DOMAIN}/**")
            assert [reply for reply in tokens if "/%door%status/" in str(reply.ok.key_expr)]
            assert viewer.refused(*set_mode, mode="colorise")
            as_user("operator")
            operator = Peer(f"127.0.0.1:{port}")
            assert board.mode == "default"
            assert operator.call(*set_mode, mode="colorise")["success"]
            as_user("operator", "guessed")
            with pytest.raises(InvalidRequest, match="does not start"):
                Peer(f"127.0.0.1:{port}")
            viewer.close()
            operator.close()
        finally:
            status, said = bridge.stop()
        assert status == 0, said


def test_an_invalid_request_is_refused_and_the_service_goes_on(bridge: Bridge, peer: Peer) -> None:
    name, kind = "/lab/cm/plan", "cm_interfaces/srv/Plan"
    assert "attachment" in peer.ask(name, kind, b"\0\1\0\0", None).err.payload.to_string()
    whole = bytes(8) + bytes(8) + b"\x10" + bytes(16)
    assert "CDR" in peer.ask(name, kind, b"nonsense", whole).err.payload.to_string()
    assert peer.call(name, kind, mode="edge_detection")["success"]


def test_a_node_that_is_gone_is_gone_from_the_graph(own: tuple[Manager, SimBoard], peer: Peer, router: Router) -> None:
    bridge = Bridge(own[0].runtime, router.where, "--name", "third", "--reliable")

    def tokens() -> list[str]:
        found = (str(reply.ok.key_expr) for reply in peer.session.liveliness().get(f"@ros2_lv/{DOMAIN}/**"))
        return [token for token in found if "/%/third" in token]

    until(lambda: len(tokens()) > 20, PATIENCE)
    bridge.process.kill()
    bridge.process.wait()
    until(lambda: not tokens(), PATIENCE)
    bridge.process.stderr.close()  # type: ignore[union-attr]


def test_the_command_says_what_is_wrong(capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    from cm.cli.main import main

    assert main(["bridge", "ros", "--router", "kria:"]) == 1
    assert "HOST" in capfd.readouterr().err
    monkeypatch.setenv("ROS_DOMAIN_ID", "999")
    assert main(["bridge", "ros"]) == 1
    assert "232" in capfd.readouterr().err
    monkeypatch.delenv("ROS_DOMAIN_ID")
    assert main(["bridge", "ros", "--write", "registers,mode"]) == 1
    assert "write mode: what is known is modes, registers, frames, or all" in capfd.readouterr().err
    monkeypatch.setenv("ZENOH_CONFIG_OVERRIDE", "mode")
    assert main(["bridge", "ros"]) == 1
    assert "KEY=VALUE" in capfd.readouterr().err
    monkeypatch.setenv("ZENOH_CONFIG_OVERRIDE", 'no/such="thing"')
    assert main(["bridge", "ros"]) == 1
    assert "no/such" in capfd.readouterr().err
