# SPDX-License-Identifier: Apache-2.0
"""Pictures of a robot's own bag come before the simulated camera, in their order."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cm.errors import InvalidRequest, NotFound
from cm.tools.replay.bag import pictures_of

rosbag2 = pytest.importorskip("rosbags.rosbag2", reason="rosbags writes the bag")
typesys = pytest.importorskip("rosbags.typesys")
pytest.importorskip("mcap_ros2", reason="bags need mcap-ros2-support")
Image = pytest.importorskip("PIL.Image")

pytestmark = pytest.mark.networks


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag with a grey camera of three pictures, a coloured one of one, and a text."""
    path = tmp_path_factory.mktemp("bags") / "robot"
    types = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    picture, header = types.types["sensor_msgs/msg/Image"], types.types["std_msgs/msg/Header"]
    moment, words = types.types["builtin_interfaces/msg/Time"], types.types["std_msgs/msg/String"]
    with rosbag2.Writer(path, version=9, storage_plugin=rosbag2.StoragePlugin.MCAP) as writer:
        grey, colour, text = (
            writer.add_connection(topic, kind.__msgtype__, typestore=types)
            for topic, kind in (("/grey", picture), ("/colour", picture), ("/said", words))
        )
        for n in range(3):
            pixels = np.full((2, 6), 255, np.uint8)  # lines of 4 pixels, with 2 bytes of nothing behind them
            pixels[:, :4] = 10 * n
            made = picture(header(moment(n, 0), "cam"), 2, 4, "mono8", 0, 6, pixels.reshape(-1))
            writer.write(grey, n * 10**9, types.serialize_cdr(made, picture.__msgtype__))
        blue = np.tile(np.array([255, 0, 0], np.uint8), 8)
        made = picture(header(moment(3, 0), "cam"), 2, 4, "bgr8", 0, 12, blue)
        writer.write(colour, 3 * 10**9, types.serialize_cdr(made, picture.__msgtype__))
        writer.write(text, 4 * 10**9, types.serialize_cdr(words("hello"), words.__msgtype__))
    return path


def read(folder: Path) -> list[int]:
    return [int(np.asarray(Image.open(path)).mean()) for path in sorted(folder.iterdir())]


@pytest.mark.parametrize(("topic", "means"), [("/grey", [0, 10, 20]), ("", [0, 10, 20]), ("/colour", [29])])
def test_pictures_come_in_their_order_as_grey(bag: Path, tmp_path: Path, topic: str, means: list[int]) -> None:
    assert pictures_of(bag, topic, tmp_path) == len(means)
    assert read(tmp_path) == means


def test_what_has_no_pictures_is_refused_by_its_name(bag: Path, tmp_path: Path) -> None:
    with pytest.raises(InvalidRequest, match="topic /said has std_msgs/msg/String"):
        pictures_of(bag, "/said", tmp_path)
    with pytest.raises(NotFound, match="topic /nowhere has no pictures"):
        pictures_of(bag, "/nowhere", tmp_path)
    with pytest.raises(NotFound, match="there is no bag in MCAP"):
        pictures_of(tmp_path / "none", "", tmp_path)
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(b"no bag")
    with pytest.raises(InvalidRequest, match=r"broken\.mcap"):
        pictures_of(broken, "", tmp_path)
