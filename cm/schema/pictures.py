# SPDX-License-Identifier: Apache-2.0
"""What frames are as pictures: encodings by ROS's names (sensor_msgs/image_encodings.hpp), and a camera's calibration.

Pure data and arithmetic, for the schema's rules and for bridges.
"""

from __future__ import annotations

import math
import re
from typing import Any

from cm.frozen import dataclass

FORMATS = {"rgb": 3, "bgr": 3, "rbg": 3, "yuv422": 2}  # of a stream's pixels in memory, with the bytes of each
_BYTES = {"8": 1, "16": 2, "32": 4, "64": 8}
_CHANNELS = {"mono": 1, "rgb": 3, "bgr": 3, "rgba": 4, "bgra": 4}
_COLOURS = re.compile(r"(mono|rgba?|bgra?)(8|16)")
_BAYER = re.compile(r"bayer_(?:rggb|bggr|gbrg|grbg)(8|16)")
_PLAIN = re.compile(r"(8|16|32|64)(?:U|S|F)C([1-9][0-9]{0,2})")
_INTERLEAVED = ("uyvy", "yuyv", "yuv422", "yuv422_yuy2")  # two bytes a pixel
_ONE_CHANNEL = {
    "bool": "mono8",
    "uint8": "mono8",
    "uint16": "mono16",
    "int8": "8SC1",
    "int16": "16SC1",
    "int32": "32SC1",
    "float32": "32FC1",
    "float64": "64FC1",
}
_COLOUR = {3: "rgb", 4: "rgba"}
_DEPTHS = {"uint8": 8, "uint16": 16}


@dataclass(frozen=True, slots=True)
class CameraInfo:
    """A camera's calibration, as ROS's camera_calibration writes it; matrices row by row."""

    width: int
    height: int
    k: tuple[float, ...]  # 3×3
    distortion_model: str = "plumb_bob"
    d: tuple[float, ...] = ()
    r: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)  # 3×3
    p: tuple[float, ...] = ()  # 3×4; empty: K, and no translation
    name: str = ""

    @property
    def projection(self) -> tuple[float, ...]:
        """The projection P, computed from K if it was left out."""
        k = self.k
        return self.p or (*k[0:3], 0.0, *k[3:6], 0.0, *k[6:9], 0.0)


_MATRICES = {
    "camera_matrix": ("k", 3, 3),
    "distortion_coefficients": ("d", 1, 0),
    "rectification_matrix": ("r", 3, 3),
    "projection_matrix": ("p", 3, 4),
}
_PLAIN_KEYS = {
    "image_width": "width",
    "image_height": "height",
    "camera_name": "name",
    "distortion_model": "distortion_model",
}


def camera_info(values: dict[str, Any]) -> CameraInfo:
    """The map of a file of camera_calibration (checked against the schema) as data."""
    found: dict[str, Any] = {_PLAIN_KEYS[key]: value for key, value in values.items() if key in _PLAIN_KEYS}
    for key, (name, _, _) in _MATRICES.items():
        if key in values:
            found[name] = tuple(float(number) for number in values[key]["data"])
    return CameraInfo(**{**found, "width": int(found["width"]), "height": int(found["height"])})


def camera_file(info: CameraInfo) -> dict[str, Any]:
    """The map that `camera_info` reads."""
    data: dict[str, Any] = {"image_width": info.width, "image_height": info.height}
    if info.name:
        data["camera_name"] = info.name
    data["distortion_model"] = info.distortion_model
    for key, (name, rows, columns) in _MATRICES.items():
        numbers = getattr(info, name)
        if numbers:
            data[key] = {"rows": rows, "cols": columns or len(numbers), "data": list(numbers)}
    return data


def pixel_bytes(encoding: str) -> int:
    """Bytes of one pixel.

    Raises KeyError for a name that ROS does not have, or whose pixels have no whole number of bytes of their own.
    """
    if encoding in _INTERLEAVED:
        return 2
    if found := _COLOURS.fullmatch(encoding):
        return _CHANNELS[found[1]] * _BYTES[found[2]]
    if found := _BAYER.fullmatch(encoding):
        return _BYTES[found[1]]
    if found := _PLAIN.fullmatch(encoding):
        return _BYTES[found[1]] * int(found[2])
    raise KeyError(encoding)


def pixel_shape(shape: tuple[int, ...] | None, form: str | None) -> tuple[int, ...] | None:
    """The shape of frames in memory: rows and columns get the bytes of a pixel of the format as their third axis."""
    if form is not None and shape is not None and len(shape) == 2:
        return (*shape, FORMATS[form])
    return shape


def format_misfit(form: str, shape: tuple[int, ...] | None, dtype: str) -> str:
    """Why frames in memory are not pictures of this format; empty if they are."""
    size = FORMATS[form]
    if dtype != "uint8":
        return f"pixels of {form} are bytes, not {dtype}"
    if shape is None or len(shape) != 3:
        return f"{form} is of pictures, and the frames have no rows and columns"
    if shape[2] != size:
        return f"a pixel of {form} has {size} bytes, not {shape[2]}"
    if form == "yuv422" and shape[1] % 2:
        return f"pixels of yuv422 share their colour in pairs, and a line has {shape[1]}"
    return ""


def misfit(encoding: str, shape: tuple[int, ...] | None, item: int) -> str:
    """Why frames of this shape, of elements of `item` bytes, are not pictures of `encoding`; empty if they are."""
    if shape is None or len(shape) < 2:
        return f"{encoding} is of pictures, and the frames have no rows and columns"
    wanted, there = pixel_bytes(encoding), item * math.prod(shape[2:])
    if wanted != there:
        return f"a pixel of {encoding} has {wanted} bytes; those of shape and dtype have {there}"
    return ""


def implied_encoding(shape: tuple[int, ...] | None, dtype: str) -> str:
    """The encoding of frames of this shape and dtype if none is declared; empty if they are not pictures."""
    if shape is None or len(shape) not in (2, 3):
        return ""
    channels = shape[2] if len(shape) == 3 else 1
    if channels == 1:
        return _ONE_CHANNEL.get(dtype, "")
    if channels in _COLOUR and dtype in _DEPTHS:
        return f"{_COLOUR[channels]}{_DEPTHS[dtype]}"
    kind = {"uint8": "8U", "int8": "8S", "uint16": "16U", "int16": "16S", "int32": "32S"}.get(dtype)
    kind = kind or {"float32": "32F", "float64": "64F"}.get(dtype)
    return f"{kind}C{channels}" if kind and channels < 1000 else ""
