# SPDX-License-Identifier: Apache-2.0
"""``cm record`` beside a manager: what its clients are told is in the file, as other people's readers see it."""

from __future__ import annotations

import contextlib
import hashlib
import os
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from manager_process import Manager, environment, served, until

from cm import child
from cm.client.errors import RequestFailed
from cm.recording import layout

pytest.importorskip("mcap", reason="needs the extra [record]")
mcap_reader = pytest.importorskip("mcap.reader")
decoder = pytest.importorskip("mcap_protobuf.decoder")

pytestmark = [pytest.mark.networks, pytest.mark.timeout(90)]


@pytest.fixture
def manager() -> Iterator[Manager]:
    with served() as (made, _):
        with made.connected() as board:
            board.load("camera", "default")
        yield made


@contextlib.contextmanager
def recording(manager: Manager, *arguments: object, said: str = "into ") -> Iterator[subprocess.Popen[str]]:
    """``cm record`` at work; ended by SIGTERM."""
    words = child.command("cm.cli.main", "record", *map(str, arguments), "--runtime-dir", str(manager.runtime))
    with subprocess.Popen(words, env=environment(), stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        try:
            assert process.stderr.readline().startswith(f"cm record: {said}")
            with manager.connected() as board:  # it listens when it is a client
                until(lambda: any(f"pid {process.pid} " in client.name for client in board.clients()))
            yield process
        finally:
            if process.poll() is None:
                process.send_signal(signal.SIGTERM)
            process.communicate(timeout=60)


def messages(path: Path) -> list[tuple[str, str, Any, Any]]:
    """Topic, schema, message and what it holds, in the order of their times, with all CRCs checked."""
    with path.open("rb") as file:
        reader = mcap_reader.make_reader(file, validate_crcs=True, decoder_factories=[decoder.DecoderFactory()])
        return [(m.channel.topic, m.schema.name, m.message, m.decoded_message) for m in reader.iter_decoded_messages()]


def of(found: list[tuple[str, str, Any, Any]], topic: str) -> list[Any]:
    return [held for its, _, _, held in found if its == topic]


def test_a_day_s_work_is_in_the_record_with_who_did_it(manager: Manager, tmp_path: Path) -> None:
    path = tmp_path / "day.mcap"
    with manager.connected() as board:
        with recording(manager, path) as recorder:
            until(lambda: path.exists() and path.stat().st_size > 0)
            generation = board.registers.write({"focus": 5}).generation
            board.load("camera", "edge_detection")
            with pytest.raises(RequestFailed):
                board.load("camera", "nowhere")
            with board.lease("registers:focus", holder="a test"):
                board.registers["focus"] = 6
            until(lambda: not board.status.leases)
        assert recorder.returncode == 0
        status = board.status
    found = messages(path)
    assert {(topic, schema) for topic, schema, _, _ in found} >= {
        (topic, f"cm.{name}") for topic, name in layout.SCHEMAS.items() if topic not in (layout.IRQ, layout.GAP)
    }
    assert not of(found, layout.GAP)
    writes = [(w.generation, {v.name: v.value for v in w.values}) for w in of(found, layout.REGISTERS) if w.generation]
    assert writes[0] == (generation, {"focus": 5})
    by = {(a.request, a.error.code, a.pid) for a in of(found, layout.AUDIT)}
    assert by >= {(r, "", os.getpid()) for r in ("WriteReg", "ChangeMode", "TakeLease", "ReleaseLease")}
    assert ("ChangeMode", "unknown_mode", os.getpid()) in by
    assert generation in {a.generation for a in of(found, layout.AUDIT)}
    statuses = of(found, layout.STATUS)
    assert {s.progress.step for s in statuses} >= {"decouple", "load", "recouple"}
    assert statuses[-1].mode == status.mode == "edge_detection"
    assert any(s.leases and s.leases[0].holder == "a test" for s in statuses)
    assert [c.mode for c in of(found, layout.CONFIG)] == ["default", "edge_detection"]
    assert "config:" in of(found, layout.CONFIG)[0].schema or of(found, layout.CONFIG)[0].schema


def test_times_are_the_manager_s_and_both_clocks_are_told(manager: Manager, tmp_path: Path) -> None:
    path = tmp_path / "times.mcap"
    with recording(manager, path, "--streams", "camera", "--frames", "hash"):
        until(lambda: path.exists() and path.stat().st_size > 4000)
    with path.open("rb") as file:
        reader = mcap_reader.make_reader(file)
        (metadata,) = [m.metadata for m in reader.iter_metadata() if m.name == layout.METADATA]
    opened = layout.opened(metadata)
    found = messages(path)
    assert all(m.publish_time == m.log_time for _, _, m, _ in found)
    for _, _, message, irq in (entry for entry in found if entry[0] == layout.IRQ):
        assert message.log_time == opened.time_of(irq.timestamp_ns)
    (_, _, message, clock), *_ = (entry for entry in found if entry[0] == layout.CLOCK)
    assert abs(message.log_time - clock.realtime_ns) < 10**9
    assert abs(opened.time_of(clock.monotonic_ns) - message.log_time) < 10**9


def test_frames_are_pictures_and_each_is_told(manager: Manager, tmp_path: Path) -> None:
    whole, hashed = tmp_path / "whole.mcap", tmp_path / "hashed.mcap"
    with recording(manager, hashed, "--streams", "all", "--frames", "hash"):
        until(lambda: hashed.exists() and b"cm_frame/camera" in hashed.read_bytes())
        with recording(manager, whole, "--streams", "camera", "--frames", "every", 2):
            until(lambda: whole.exists() and whole.stat().st_size > 8 << 20)
    pictures = of(messages(whole), "cm_stream/camera")
    seen = of(messages(whole), "cm_frame/camera")
    kept = [s.frame for s in seen if s.kept]
    assert [f.sequence for f in kept] == [s.frame.sequence for s in seen if s.frame.sequence % 2 == 0]
    assert len(pictures) == len(kept) > 2
    for picture, frame in zip(pictures, kept, strict=True):
        assert (picture.height, picture.width) == tuple(frame.shape[:2])
        assert picture.encoding == "mono8"
        assert len(picture.data) == frame.length == picture.height * picture.step
    digests = {s.frame.sequence: s.sha256 for s in of(messages(hashed), "cm_frame/camera")}
    both = [(p, f) for p, f in zip(pictures, kept, strict=True) if f.sequence in digests]
    assert both
    for picture, frame in both:
        assert hashlib.sha256(picture.data).digest() == digests[frame.sequence]


@pytest.mark.parametrize("name", ["from_lp", "to_pl"], ids=["mistyped", "towards the hardware"])
def test_a_stream_that_can_never_be_recorded_is_told(manager: Manager, tmp_path: Path, name: str) -> None:
    said = f"no configuration has a stream '{name}' from the hardware; did you mean 'from_pl'?\n"
    with recording(manager, tmp_path / "a.mcap", "--streams", "camera", name, said=said):
        pass


def test_a_manager_that_is_gone_for_a_while_is_a_gap(manager: Manager, tmp_path: Path) -> None:
    path = tmp_path / "gone.mcap"
    with recording(manager, path) as recorder:
        until(lambda: path.exists() and path.stat().st_size > 0)
        manager.kill()
        manager.start()
        assert recorder.stderr is not None
        for line in recorder.stderr:
            if "is back" in line:
                break
    (gap,) = of(messages(path), layout.GAP)
    assert (gap.cause, gap.topic) == ("manager_gone", "")
    assert gap.from_ns < gap.until_ns
    assert len({s.started_ns for s in of(messages(path), layout.STATUS)}) == 2


def test_a_bag_has_the_topics_of_the_ros_node_as_rosbags_reads_them(manager: Manager, tmp_path: Path) -> None:
    bags, typesys = pytest.importorskip("rosbags.rosbag2"), pytest.importorskip("rosbags.typesys")
    bag = tmp_path / "bag"
    with manager.connected() as board, recording(manager, bag, "--ros2", "--streams", "camera") as recorder:
        until(lambda: sum(path.stat().st_size for path in bag.glob("*.mcap")) > 1 << 20)
        board.registers["focus"] = 7
        board.load("camera", "edge_detection")
        size = sum(path.stat().st_size for path in bag.glob("*.mcap"))
        until(lambda: sum(path.stat().st_size for path in bag.glob("*.mcap")) > size + (1 << 20))
    assert recorder.returncode == 0
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    for path in (Path(__file__).parents[2] / "ros2/cm_interfaces/msg").glob("*.msg"):
        kind = f"cm_interfaces/msg/{path.stem}"
        store.register(typesys.get_types_from_msg(path.read_text(), kind))
    with bags.Reader(bag) as reader:
        kinds = {connection.topic: connection.msgtype for connection in reader.connections}
        held: dict[str, list[Any]] = {topic: [] for topic in kinds}
        for connection, _, data in reader.messages():
            held[connection.topic].append(store.deserialize_cdr(data, connection.msgtype))
        counted = {topic: info.msgcount for topic, info in reader.topics.items()}
    assert {topic: len(found) for topic, found in held.items()} == counted
    assert (
        kinds.items()
        >= {
            "/cm/status": "cm_interfaces/msg/Status",
            "/cm/configuration": "cm_interfaces/msg/Configuration",
            "/cm/registers": "cm_interfaces/msg/RegisterBank",
            "/cm/interrupts": "cm_interfaces/msg/Interrupt",
            "/cm/camera/image_raw": "sensor_msgs/msg/Image",
            "/cm/camera/camera_info": "sensor_msgs/msg/CameraInfo",
            "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
        }.items()
    )
    assert held["/cm/status"][-1].mode == "edge_detection"
    assert [(r.name, r.value) for r in held["/cm/registers"][0].registers] == [("focus", 7)]
    image = held["/cm/camera/image_raw"][0]
    assert len(image.data) == image.height * image.step > 0


def test_the_settings_describe_the_black_box(manager: Manager, tmp_path: Path) -> None:
    box, settings = tmp_path / "box", tmp_path / "cm.yaml"
    settings.write_text(f"record:\n  folder: {box}\n  ring: 1h\n  streams: [camera]\n  frames: hash\n")
    with recording(manager, "--settings", settings):
        until(lambda: list(box.glob("*.mcap")) and sum(path.stat().st_size for path in box.glob("*.mcap")) > 20_000)
    (path,) = layout.files_of(box)
    assert all(len(seen.sha256) == 32 and not seen.kept for seen in of(messages(path), "cm_frame/camera"))
    assert of(messages(path), "cm_frame/camera")
    settings.write_text("log: info\n")
    words = child.command("cm.cli.main", "record", "--settings", str(settings))
    done = subprocess.run(words, env=environment(), capture_output=True, text=True, check=True)
    assert "nothing is recorded" in done.stderr
