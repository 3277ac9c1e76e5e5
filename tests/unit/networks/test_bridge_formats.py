# SPDX-License-Identifier: Apache-2.0
"""How a bridge describes frames, without a manager."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

import cm.schema
from cm.networks.bridge.records import config_record, encoding_of, frame_record, stream_format
from cm.networks.ros.messages import diagnostics
from cm.schema.model import Direction, Stream
from cm.schema.pictures import CameraInfo, camera_file, camera_info, pixel_bytes
from cm.wire.messages.status import (
    ConfigInfo,
    FrameInfo,
    RegionHealth,
    RegionStatus,
    RegisterInfo,
    Status,
    StreamStatus,
)

CALIBRATION = """\
image_width: 640
image_height: 480
camera_name: narrow_stereo
camera_matrix:
  rows: 3
  cols: 3
  data: [438.783367, 0.000000, 305.593336, 0.000000, 437.302876, 243.738352, 0.000000, 0.000000, 1.000000]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.361976, 0.110510, 0.001014, 0.000505, 0.000000]
rectification_matrix:
  rows: 3
  cols: 3
  data: [0.999978, 0.002789, -0.006046, -0.002816, 0.999986, -0.004401, 0.006034, 0.004417, 0.999972]
projection_matrix:
  rows: 3
  cols: 4
  data: [393.653800, 0.000000, 322.797939, 0.000000, 0.000000, 393.653800, 241.090902, 0.000000, 0.000000, 0.000000, 1.000000, 0.000000]
"""  # noqa: E501 (as the tool writes it)

SCHEMA = """\
config:
  name: eye
  modules: {plain: {}, deep: {}}
  streams:
    front: {direction: s2mm, shape: [4, 6], encoding: bayer_rggb8, frame_id: head/left}
    samples: {direction: s2mm}
  modes:
    default: {modules: [plain]}
    deep: {modules: [deep], streams: {front: {dtype: uint16, encoding: 16UC1}}}
"""


def test_a_file_of_camera_calibration_fits_a_schema_as_it_is() -> None:
    inner = "\n".join(f"        {line}" for line in CALIBRATION.splitlines())
    stream = "    eye:\n      direction: s2mm\n      shape: [480, 640]\n      camera_info:\n"
    config = cm.schema.loads(f"config:\n  name: c\n  modes: {{default: {{}}}}\n  streams:\n{stream}{inner}\n")
    info = config.streams["eye"].camera_info
    assert info is not None
    assert (info.width, info.height, info.distortion_model, len(info.d)) == (640, 480, "plumb_bob", 5)
    assert info.k[0] == 438.783367
    assert info.projection[2] == 322.797939
    assert camera_info(camera_file(info)) == info


def test_a_calibration_without_a_projection_has_that_of_the_camera_itself() -> None:
    info = CameraInfo(4, 4, k=tuple(range(9)))
    assert info.projection == (0, 1, 2, 0, 3, 4, 5, 0, 6, 7, 8, 0)


@pytest.mark.parametrize(
    ("name", "length"),
    [("mono8", 1), ("rgb8", 3), ("bgra16", 8), ("bayer_gbrg16", 2), ("yuv422_yuy2", 2), ("32FC4", 16), ("8UC12", 12)],
)
def test_pixels_have_the_bytes_that_ros_says(name: str, length: int) -> None:
    assert pixel_bytes(name) == length


@pytest.mark.parametrize(
    ("shape", "dtype", "said", "encoding"),
    [
        ((4, 6), "uint8", None, "mono8"),
        ((4, 6, 3), "uint8", None, "rgb8"),
        ((4, 6, 3), "uint8", "bgr8", "bgr8"),
        ((4, 6, 3), "uint8", "mono8", "rgb8"),  # another shape than the schema's, set at run time
        ((4, 6, 2), "uint8", "uyvy", "uyvy"),
        ((4, 6), "uint32", "rgba8", "rgba8"),
        ((4, 6), "uint32", None, ""),
        ((4, 6), "complex64", None, ""),
        ((4, 6, 5), "float32", None, "32FC5"),
        ((24,), "uint8", None, ""),
        ((24,), "uint8", "mono8", ""),
        ((2, 3, 4, 5), "uint8", None, ""),
    ],
)
def test_frames_have_the_stated_encoding_if_it_fits_and_otherwise_a_guessed_one(
    shape: tuple[int, ...], dtype: str, said: str | None, encoding: str
) -> None:
    assert encoding_of(shape, dtype, said) == encoding


def status(mode: str = "default", dtype: str = "uint8") -> Status:
    streams = (StreamStatus("front", "front", "s2mm", (4, 6), dtype), StreamStatus("samples", "samples", "s2mm"))
    regions = (RegionStatus("prr0", "plain" if mode == "default" else "deep", "ready"),)
    return Status("eye", mode, streams=streams, regions=regions, board="b1", started_ns=7, configs=("eye", "other"))


def test_each_stream_is_described_as_the_mode_has_it() -> None:
    info = ConfigInfo("eye", mode="default", schema=SCHEMA)
    record = config_record(status(), info, 5)
    assert record.stamp_ns == 5
    front, samples = record.streams
    assert (front.encoding, front.frame_id, front.writes) == ("bayer_rggb8", "head/left", False)
    assert (samples.encoding, samples.frame_id) == ("", "samples")
    deep = config_record(status("deep", "uint16"), info, 5).stream("front")
    assert deep is not None
    assert deep.encoding == "16UC1"


def test_with_an_unreadable_schema_the_status_alone_is_used() -> None:
    record = config_record(status(), ConfigInfo("eye", schema="config: {name: eye, of_the_future: 1}"), 0)
    assert [stream.encoding for stream in record.streams] == ["mono8", ""]


def test_only_registers_of_the_mode_are_its_registers() -> None:
    registers = (RegisterInfo("a", 0, 32, "rw"), RegisterInfo("b", 4, 32, "rw", modes=("deep",)))
    record = config_record(status(), ConfigInfo("eye", mode="default", registers=registers), 0)
    assert [register.name for register in record.registers] == ["a"]


def test_a_frame_has_wall_time_and_rows() -> None:
    array = np.arange(4 * 6 * 3, dtype=np.uint8).reshape(4, 6, 3)
    info = FrameInfo("front", 9, 1_000, array.nbytes, array.shape, "uint8", "eye", "deep", generation=3)
    said = Stream("front", "front", Direction.S2MM, shape=(4, 6, 3), encoding="bgr8")
    record = frame_record(stream_format(StreamStatus("front", "front", "s2mm", (4, 6, 3)), said), array, info, 500)
    assert (record.stamp_ns, record.sequence, record.encoding, record.frame_id) == (1_500, 9, "bgr8", "front")
    assert (record.height, record.width, record.step) == (4, 6, 18)
    assert record.data is array.view(np.ndarray) or np.shares_memory(record.data, array)
    assert record.data.dtype == "uint8"


def test_a_frame_that_is_not_a_picture_has_no_rows() -> None:
    array = np.zeros(24, np.float32)
    info = FrameInfo("samples", 0, 0, array.nbytes, array.shape, "float32")
    record = frame_record(stream_format(StreamStatus("samples", "samples", "s2mm"), None), array, info, 0)
    assert (record.encoding, record.height, record.width, record.step) == ("", 0, 0, 0)


def test_the_core_knows_no_network_but_the_managers() -> None:
    code = (
        "import sys\nfor name in ('rclpy', 'zenoh'): sys.modules[name] = None\n"
        "from cm.networks.bridge import commands, follower, records, streams"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_diagnostics_tell_what_checks_of_a_region_have_found() -> None:
    repaired, wrong = RegionHealth(checks=3, upsets=2, repairs=1), RegionHealth(checks=1, upsets=4, wrong_bits=4)
    regions = (
        RegionStatus("a", "edge", "ready", health=repaired),
        RegionStatus("b", "edge", "ready", health=wrong),
        RegionStatus("c", None, "unknown"),
    )
    told = diagnostics("/cm", Status("camera", "edge", regions=regions, board="kria"), "", 1)["status"]
    rows = {row["name"]: (row["level"], row["message"]) for row in told}
    assert rows == {
        "/cm: board": (0, "camera/edge"),
        "/cm: region a": (0, "2 upsets found, 1 repairs"),
        "/cm: region b": (1, "4 bits are wrong"),
    }
    assert {row["hardware_id"] for row in told} == {"kria"}
    values = {pair["key"]: pair["value"] for pair in told[1]["values"]}
    quiet = dict.fromkeys(("wrong_bits", "frames", "unjudged", "checked_ns"), "0")
    assert values == {"checks": "3", "upsets": "2", "repairs": "1"} | quiet
    assert [row["level"] for row in diagnostics("/cm", None, "no manager", 1)["status"]] == [3]
