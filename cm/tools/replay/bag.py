# SPDX-License-Identifier: Apache-2.0
"""Pictures of a robot's own bag (rosbag2 in MCAP), as files that the simulated camera takes one after the other."""

from __future__ import annotations

import io
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from cm.errors import InvalidRequest, NotFound, NotInstalled
from cm.extras import installing

_IMAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
_CHANNELS = {"mono8": 1, "8UC1": 1, "rgb8": 3, "bgr8": 3, "rgba8": 4, "bgra8": 4, "8UC3": 3}


def pictures_of(bag: Path, topic: str, folder: Path) -> int:
    """Write the pictures of a bag's camera topic to a folder, in their order; how many. Empty: its only such topic.

    Raises InvalidRequest, NotFound, NotInstalled.
    """
    count = 0
    for count, image in enumerate(_images(_files(bag), topic), 1):
        image.save(folder / f"{count:06d}.png", compress_level=1)
    if not count:
        raise NotFound(f"{bag}: topic {topic or '(any)'} has no pictures")
    return count


def _files(bag: Path) -> list[Path]:
    found = sorted(bag.glob("*.mcap")) if bag.is_dir() else [bag]
    if not found or not all(path.is_file() for path in found):
        raise NotFound(f"{bag}: there is no bag in MCAP")
    return found


def _images(files: list[Path], topic: str) -> Iterator[Any]:
    try:
        from mcap.exceptions import McapError
        from mcap.reader import make_reader
        from mcap_ros2.decoder import DecoderFactory
    except ModuleNotFoundError as error:
        raise NotInstalled(f"bags need the Python module {error.name}: pip install mcap-ros2-support") from None
    for file in files:
        try:
            with file.open("rb") as stream:
                reader = make_reader(stream, decoder_factories=[DecoderFactory()])
                for schema, channel, _, decoded in reader.iter_decoded_messages([topic] if topic else None):
                    kind = schema.name if schema is not None else ""
                    if kind in _IMAGES and (topic := topic or channel.topic) == channel.topic:
                        yield _image(decoded, kind)
                    elif channel.topic == topic:
                        raise InvalidRequest(f"{file}: topic {topic} has {kind}, and no pictures")
        except (McapError, struct.error, ValueError, EOFError, OSError) as error:
            raise InvalidRequest(f"{file}: {error or type(error).__name__}") from error


def _image(message: Any, kind: str) -> Any:
    try:
        from PIL import Image
    except ModuleNotFoundError:
        raise NotInstalled(f"pictures need Pillow: {installing('demo')}") from None
    data = bytes(message.data)
    if kind == _IMAGES[1]:
        return Image.open(io.BytesIO(data)).convert("L")
    channels = _CHANNELS.get(message.encoding)
    if channels is None:
        raise InvalidRequest(f"pictures of encoding {message.encoding!r}; known are {', '.join(_CHANNELS)}")
    rows = np.frombuffer(data, np.uint8)[: message.height * message.step].reshape(message.height, message.step)
    pixels = rows[:, : message.width * channels].reshape(message.height, message.width, channels)
    if channels == 1:
        return Image.fromarray(np.ascontiguousarray(pixels[:, :, 0]))
    colours = pixels[:, :, 2::-1] if message.encoding.startswith("bgr") else pixels[:, :, :3]
    return Image.fromarray(np.ascontiguousarray(colours)).convert("L")
