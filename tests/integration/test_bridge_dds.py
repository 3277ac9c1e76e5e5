# SPDX-License-Identifier: Apache-2.0
"""A board as a ROS 2 node on DDS: what another participant, in another process, sees of it and asks of it."""

from __future__ import annotations

import itertools
import os
import queue
from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
import pytest
from manager_process import Manager, until

import cm
from cm.sim import Board as SimBoard

pytest.importorskip("cyclonedds.domain")

from dds_support import PATIENCE, Bridge, Client, Peer, domain

from cm.ros import cdr
from cm.ros.transport import EVENTS, LATCHED, SENSOR_DATA, Qos
from cm.ros.typehash import type_hash

IMAGE, DATA = "sensor_msgs/msg/Image", "cm_interfaces/msg/Data"


@pytest.fixture(scope="module")
def peer() -> Iterator[Peer]:
    made = Peer()
    yield made
    made.close()


@pytest.fixture(scope="module")
def bridge(shared: tuple[Manager, SimBoard], peer: Peer) -> Iterator[Bridge]:
    """The shared manager as the node /lab/cm."""
    made = Bridge(shared[0].runtime, "--namespace", "/lab")
    yield made
    status, said = made.stop()
    assert status == 0, said
    assert "Traceback" not in said


def test_a_late_subscriber_gets_the_status_and_then_every_change(bridge: Bridge, peer: Peer, board: cm.Board) -> None:
    with peer.listening("/lab/cm/status", "cm_interfaces/msg/Status", LATCHED) as statuses:
        while (first := statuses.get(timeout=PATIENCE))["mode"] != "default":
            pass  # from before the board was reloaded
        assert first["config_name"] == "camera"
        assert first["board"] == board.status.board
        board.mode = "edge_detection"
        while (last := statuses.get(timeout=PATIENCE))["mode"] != "edge_detection" or last["fpga_busy"]:
            pass
    assert {"name": "prr0", "module": "edge", "state": "ready"} in last["regions"]
    assert last["pr_mode"] == "idle"


def test_what_runs_is_reported_with_its_modes_and_streams(bridge: Bridge, peer: Peer, board: cm.Board) -> None:
    told = peer.next("/lab/cm/configuration", "cm_interfaces/msg/Configuration", LATCHED, lambda c: c["mode"])
    assert "colorise" in [mode["name"] for mode in told["modes"]]
    assert (told["readable_streams"], told["writable_streams"]) == (["camera", "from_pl"], ["to_pl"])


def test_pictures_run_while_there_is_a_listener_and_are_those_of_the_board(
    bridge: Bridge, peer: Peer, board: cm.Board
) -> None:
    def camera() -> Any:
        return next(stream for stream in board.status.streams if stream.name == "camera")

    until(lambda: not camera().open, PATIENCE)
    with (
        peer.listening("/lab/cm/camera/image_raw", IMAGE, SENSOR_DATA) as images,
        peer.listening("/lab/cm/camera/camera_info", "sensor_msgs/msg/CameraInfo", SENSOR_DATA) as infos,
    ):
        image = images.get(timeout=PATIENCE)
        info = infos.get(timeout=PATIENCE)
        assert camera().open
    assert (image["encoding"], image["height"], image["width"], image["step"]) == ("mono8", 480, 640, 640)
    assert len(image["data"]) == 480 * 640
    assert len(set(bytes(image["data"]))) > 10
    assert (info["height"], info["width"], info["header"]["frame_id"]) == (480, 640, "camera")
    until(lambda: not camera().open, PATIENCE)


def test_a_mode_with_another_encoding_is_reported_in_the_picture(bridge: Bridge, peer: Peer, board: cm.Board) -> None:
    board.mode = "colorise"
    image = peer.next("/lab/cm/camera/image_raw", IMAGE, SENSOR_DATA, lambda i: i["encoding"] == "rgb8")
    assert (image["step"], len(image["data"])) == (1920, 480 * 640 * 3)


def test_a_picture_goes_through_the_accelerator_and_comes_back_as_it_was(
    bridge: Bridge, peer: Peer, board: cm.Board
) -> None:
    board.mode = "loopback"
    picture = np.random.default_rng(5).integers(0, 255, (480, 640), np.uint8)
    padded = np.zeros((480, 700), np.uint8)
    padded[:, :640] = picture
    head = {"height": 480, "width": 640, "encoding": "mono8"}
    publisher = peer.transport.publisher("/lab/cm/to_pl/write", IMAGE, EVENTS)
    with peer.listening("/lab/cm/from_pl/image_raw", IMAGE, Qos(5)) as back:
        until(lambda: publisher.listeners() and _open(board, "from_pl"), PATIENCE)
        for sent, step in ((picture, 640), (padded, 700)):
            publisher.write({**head, "step": step, "data": sent.tobytes()})
            assert bytes(back.get(timeout=PATIENCE)["data"]) == picture.tobytes()
        publisher.write({**head, "encoding": "rgb8", "step": 640, "data": picture.tobytes()})  # refused, logged
        publisher.write({**head, "step": 640, "data": picture.tobytes()})
        assert bytes(back.get(timeout=PATIENCE)["data"]) == picture.tobytes()
    publisher.close()


def _open(board: cm.Board, name: str) -> bool:
    return next(stream for stream in board.status.streams if stream.name == name).open


def test_register_writes_by_any_client_are_reported_and_so_are_interrupts(
    bridge: Bridge, peer: Peer, board: cm.Board
) -> None:
    with (
        peer.listening("/lab/cm/registers", "cm_interfaces/msg/RegisterBank", EVENTS) as banks,
        peer.listening("/parameter_events", "rcl_interfaces/msg/ParameterEvent", EVENTS) as events,
    ):
        number = itertools.count()

        def heard() -> bool:  # matched on one side does not mean matched on the other
            board.registers["focus"] = next(number) % 4 + 4
            return bool(banks.qsize() and events.qsize())

        until(heard, PATIENCE)
        bank, event = banks.get(), events.get()
    assert bank["registers"][0]["name"] == "focus"
    assert (event["node"], event["changed_parameters"][0]["name"]) == ("/lab/cm", "registers.focus")
    with board.stream("camera", timeout=PATIENCE) as frames:
        frames.read()
        interrupt = peer.next("/lab/cm/interrupts", "cm_interfaces/msg/Interrupt", EVENTS)
    assert interrupt["name"] == "frame_done"


def test_services_act_as_documented_and_give_reasons_for_refusals(bridge: Bridge, peer: Peer, board: cm.Board) -> None:
    def call(name: str, kind: str, **request: Any) -> dict[str, Any]:
        return peer.call(f"/lab/cm/{name}", f"cm_interfaces/srv/{kind}", **request)

    assert call("plan", "Plan", mode="edge_detection")["bytes"] > 0
    assert call("set_mode", "SetMode", mode="edge_detection")["success"]
    assert board.mode == "edge_detection"
    refused = call("set_mode", "SetMode", mode="nowhere")
    assert (refused["success"], refused["code"]) == (False, "unknown_mode")
    assert call("load_config", "LoadConfig", config_name="camera")["success"]
    assert board.mode == "default"
    writes = [{"name": "focus", "value": 7}, {"name": "led.blink", "value_name": "fast"}]
    assert call("write_registers", "WriteRegisters", writes=writes)["success"]
    masked = [{"name": "focus", "value": 0xF, "use_mask": True, "mask": 0x8}]
    assert call("write_registers", "WriteRegisters", writes=masked)["bank"]["registers"][0]["value"] == 0xF
    bank = call("read_registers", "ReadRegisters", names=["focus", "led.blink"])["bank"]
    assert [register["value"] for register in bank["registers"]] == [0xF, 2]
    too_much = call("write_registers", "WriteRegisters", writes=[{"name": "focus", "value": 99}])
    assert (too_much["success"], "15" in too_much["message"]) == (False, True)


def test_a_lease_of_others_refuses_and_its_own_id_passes(bridge: Bridge, peer: Peer, board: cm.Board) -> None:
    with board.lease("board", seconds=60) as lease:
        client = peer.client("/lab/cm/set_mode", "cm_interfaces/srv/SetMode")
        assert client.call({"mode": "edge_detection"})["code"] == "held_by"
        assert client.call({"mode": "edge_detection", "lease": lease.id})["success"]


def test_registers_are_parameters_with_their_ranges(bridge: Bridge, peer: Peer, board: cm.Board) -> None:
    def call(name: str, kind: str, **request: Any) -> dict[str, Any]:
        return peer.call(f"/lab/cm/{name}", f"rcl_interfaces/srv/{kind}", **request)

    names = call("list_parameters", "ListParameters")["result"]["names"]
    assert {"registers.focus", "registers.led", "fields.led.blink", "registers.version"} <= set(names)
    assert "registers.palette" not in names  # of another mode
    assert not [name for name in names if any(other.startswith(f"{name}.") for other in names)]  # ros2 param dump
    fields = call("list_parameters", "ListParameters", prefixes=["fields.led"])["result"]
    assert set(fields["names"]) == {"fields.led.blink", "fields.led.pattern"}
    focus, version, blink = call(
        "describe_parameters", "DescribeParameters",
        names=["registers.focus", "registers.version", "fields.led.blink"],
    )["descriptors"]  # fmt: skip
    assert focus["integer_range"] == [{"from_value": 0, "to_value": 15, "step": 1}]
    assert (focus["read_only"], version["read_only"]) == (False, True)
    assert "fast = 2" in blink["additional_constraints"]
    good = {"name": "registers.focus", "value": {"type": 2, "integer_value": 9}}
    bad = {"name": "registers.focus", "value": {"type": 2, "integer_value": 16}}
    text = {"name": "registers.focus", "value": {"type": 4, "string_value": "9"}}
    results = call("set_parameters", "SetParameters", parameters=[good, bad, text])["results"]
    assert [result["successful"] for result in results] == [True, False, False]
    values = call("get_parameters", "GetParameters", names=["registers.focus", "nothing"])["values"]
    assert [(value["type"], value["integer_value"]) for value in values] == [(2, 9), (0, 0)]
    two = [{"name": "registers.zoom", "value": {"type": 2, "integer_value": 2}}, bad]
    assert not call("set_parameters_atomically", "SetParametersAtomically", parameters=two)["result"]["successful"]
    assert board.registers["zoom"] == 1
    types = call("get_parameter_types", "GetParameterTypes", names=["registers.focus", "nothing"])["types"]
    assert bytes(types) == b"\2\0"


def test_an_action_goes_to_a_mode_with_progress_and_a_result(bridge: Bridge, peer: Peer, board: cm.Board) -> None:
    base, kind = "/lab/cm/change_mode/_action", "cm_interfaces/action/ChangeMode"
    uuid = {"uuid": os.urandom(16)}
    with (
        peer.listening(f"{base}/feedback", f"{kind}_FeedbackMessage", EVENTS) as feedback,
        peer.listening(f"{base}/status", "action_msgs/msg/GoalStatusArray", LATCHED) as statuses,
    ):
        ends = {
            name: peer.client(f"{base}/{name}", f"{kind}_{part}")
            for name, part in (("send_goal", "SendGoal"), ("get_result", "GetResult"))
        }
        assert ends["send_goal"].call({"goal_id": uuid, "goal": {"mode": "edge_detection"}})["accepted"]
        assert not ends["send_goal"].call({"goal_id": uuid, "goal": {"mode": "edge_detection"}})["accepted"]
        result = ends["get_result"].call({"goal_id": uuid})
        assert (result["status"], result["result"]["success"]) == (4, True)
        _until_ended(statuses, uuid["uuid"], 4)
        _await_feedback(feedback, ends["send_goal"], ends["get_result"])
        second = {"uuid": os.urandom(16)}
        ends["send_goal"].call({"goal_id": second, "goal": {"mode": "nowhere"}})
        failed = ends["get_result"].call({"goal_id": second})
        assert (failed["status"], failed["result"]["code"]) == (6, "unknown_mode")
    cancel = peer.client(f"{base}/cancel_goal", "action_msgs/srv/CancelGoal")
    info = {"goal_id": uuid, "stamp": {}}
    assert cancel.call({"goal_info": info})["return_code"] == 3  # it has ended
    assert cancel.call({"goal_info": {"goal_id": {"uuid": os.urandom(16)}}})["return_code"] == 2


def _until_ended(statuses: queue.Queue[dict[str, Any]], uuid: bytes, status: int) -> None:
    while True:
        for row in statuses.get(timeout=PATIENCE)["status_list"]:
            if bytes(row["goal_info"]["goal_id"]["uuid"]) == uuid and row["status"] == status:
                return


def _await_feedback(feedback: queue.Queue[dict[str, Any]], send: Client, result: Client) -> None:
    """Send goals until their feedback arrives: our subscription may be discovered after our client."""
    modes = itertools.cycle(("default", "edge_detection"))

    def heard() -> bool:
        goal = {"uuid": os.urandom(16)}
        send.call({"goal_id": goal, "goal": {"mode": next(modes)}})
        result.call({"goal_id": goal})
        return feedback.qsize() > 0

    until(heard, PATIENCE)
    steps = [feedback.get()["feedback"] for _ in range(feedback.qsize())]
    assert all(step["step"] and 0 <= step["fraction"] <= 1 for step in steps)


def test_a_goal_that_is_cancelled_ends_as_cancelled_and_the_board_is_back(
    own: tuple[Manager, SimBoard], peer: Peer
) -> None:
    manager, sim = own
    with manager.connected() as board:
        board.load("camera", "default")
        bridge = Bridge(manager.runtime, "--name", "third")
        base, kind = "/third/change_mode/_action", "cm_interfaces/action/ChangeMode"
        ends = {
            name: peer.client(f"{base}/{name}", f"{kind}_{part}")
            for name, part in (("send_goal", "SendGoal"), ("get_result", "GetResult"))
        }
        cancel = peer.client(f"{base}/cancel_goal", "action_msgs/srv/CancelGoal")
        code, ended = 3, 6
        while code == 3 or ended == 6:  # the goal had ended, or its load had taken too long, before it was cancelled
            uuid, before = {"uuid": os.urandom(16)}, board.status.last_change
            sim.control.inject("icap_hang", count=1)
            assert ends["send_goal"].call({"goal_id": uuid, "goal": {"mode": "edge_detection"}})["accepted"]
            # the load hangs, and not the one that goes back
            until(lambda last=before: not sim.control.state()["faults"] or board.status.last_change != last, PATIENCE)
            code = cancel.call({"goal_info": {"goal_id": uuid}})["return_code"]
            ended = ends["get_result"].call({"goal_id": uuid})["status"]
        assert (code, ended) == (0, 5)
        assert board.mode == "default"
        assert bridge.stop()[0] == 0


def test_diagnostics_tell_of_the_board(bridge: Bridge, peer: Peer, board: cm.Board) -> None:
    def ours(told: Any) -> bool:  # an outdated status comes first
        return bool(told["status"][0]["name"] == "lab/cm: board" and told["status"][0]["message"] == "camera/default")

    row = peer.next("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", EVENTS, ours)["status"][0]
    assert (row["level"], row["hardware_id"]) == (0, board.status.board)
    assert {"key": "config_name", "value": "camera"} in row["values"]


def test_ros_tools_find_a_node_its_endpoints_their_hashes_and_quality(
    bridge: Bridge, peer: Peer, board: cm.Board
) -> None:
    from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication, BuiltinTopicDcpsSubscription
    from cyclonedds.core import Policy

    readers = {
        kind: BuiltinDataReader(peer.participant, kind)
        for kind in (BuiltinTopicDcpsPublication, BuiltinTopicDcpsSubscription)
    }
    wanted = {
        "image": ("rt/lab/cm/camera/image_raw", "sensor_msgs::msg::dds_::Image_"),
        "status": ("rt/lab/cm/status", "cm_interfaces::msg::dds_::Status_"),
        "service": ("rq/lab/cm/set_modeRequest", "cm_interfaces::srv::dds_::SetMode_Request_"),
    }
    ends: dict[bytes, Any] = {}

    def found(name: str) -> Any:  # discovery takes time
        ends.update((end.key.bytes, end) for reader in readers.values() for end in reader.read(N=500))
        return next((end for end in ends.values() if (end.topic_name, end.type_name) == wanted[name]), None)

    image, status, service = (until(partial(found, name), PATIENCE) for name in wanted)
    assert f"typehash={type_hash(IMAGE)};".encode() in image.qos[Policy.Userdata].data
    assert Policy.Durability.TransientLocal in status.qos
    assert service.qos[Policy.Userdata].data.startswith(b"serviceid=")
    node = _node_of(peer, "/lab", "cm")
    gids = {bytes(g["data"]) for key in ("reader_gid_seq", "writer_gid_seq") for g in node[key]}
    assert {image.key.bytes, status.key.bytes, service.key.bytes} <= gids
    until(lambda: found("image") and gids <= ends.keys(), PATIENCE)


def _node_of(peer: Peer, namespace: str, name: str) -> dict[str, Any]:
    """The node, as ROS's own graph cache discovers it."""
    from cyclonedds.sub import DataReader
    from cyclonedds.topic import Topic
    from cyclonedds.util import duration

    from cm.dds.qos import qos
    from cm.dds.types import sample_type

    kind = "rmw_dds_common/msg/ParticipantEntitiesInfo"
    topic = Topic(peer.participant, "ros_discovery_info", sample_type(kind))
    reader = DataReader(peer.participant, topic, qos=qos(LATCHED, type_hash(kind)))
    for sample in reader.take_iter(timeout=duration(seconds=PATIENCE)):
        for node in cdr.decode(kind, sample.data)["node_entities_info_seq"]:
            if (node["node_namespace"], node["node_name"]) == (namespace, name):
                return dict(node)
    raise AssertionError("no such node")


def test_an_invalid_sample_is_refused_and_the_node_goes_on(bridge: Bridge, peer: Peer, board: cm.Board) -> None:
    from cyclonedds._clayer import ddspy_write

    client = peer.client("/lab/cm/plan", "cm_interfaces/srv/Plan")
    ddspy_write(client._writer._ref, cdr.HEADER + bytes(16) + b"\1\0\0\0\0\0\0\0\1\0\0\0\0\0\0\0")
    assert client.call({"mode": "edge_detection"})["success"]


def test_a_manager_that_is_killed_is_reported_and_the_node_goes_on_with_its_return(
    own: tuple[Manager, SimBoard], peer: Peer
) -> None:
    manager, _ = own
    with manager.connected() as connected:
        connected.load("camera")
    bridge = Bridge(manager.runtime, "--name", "second", "--patience", "0.5")
    try:
        kind = "diagnostic_msgs/msg/DiagnosticArray"

        def level(wanted: int) -> Any:
            return lambda told: told["status"][0]["name"] == "second: board" and told["status"][0]["level"] == wanted

        peer.next("/diagnostics", kind, EVENTS, level(0))
        manager.kill()
        stale = peer.next("/diagnostics", kind, EVENTS, level(3))
        assert stale["status"][0]["message"]
        manager.start()
        peer.next("/diagnostics", kind, EVENTS, level(0))
        client: Client = peer.client("/second/read_registers", "cm_interfaces/srv/ReadRegisters")
        until(lambda: client.call({"names": ["focus"]})["success"], PATIENCE)
    finally:
        status, said = bridge.stop()
    assert status == 0, said


def test_the_command_says_what_is_wrong(capfd: pytest.CaptureFixture[str]) -> None:
    from cm.cli.main import main

    assert main(["bridge", "dds", "--domain", "999"]) == 1
    assert "232" in capfd.readouterr().err
    assert main(["bridge", "dds", "--namespace", "lab"]) == 1
    assert "/lab" in capfd.readouterr().err
    assert main(["bridge", "dds", "--name", "my-board"]) == 1
    assert "letters" in capfd.readouterr().err
    assert main(["bridge", "dds", "--settings"]) == 0
    assert "SocketReceiveBufferSize" in capfd.readouterr().out
    assert domain() < 232
