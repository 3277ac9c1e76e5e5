# SPDX-License-Identifier: Apache-2.0
"""The encoding of frames that declare none, by ROS's names (sensor_msgs/image_encodings.hpp)."""

from __future__ import annotations

import pytest

from cm.schema.pictures import implied_encoding


@pytest.mark.parametrize(
    ("shape", "dtype", "encoding"),
    [
        ((4, 6), "uint8", "mono8"),
        ((4, 6, 1), "uint16", "mono16"),
        ((4, 6, 3), "uint8", "rgb8"),
        ((4, 6, 4), "uint16", "rgba16"),
        ((4, 6, 2), "uint8", "8UC2"),
        ((4, 6, 2), "int8", "8SC2"),
        ((4, 6, 2), "uint16", "16UC2"),
        ((4, 6, 3), "int16", "16SC3"),
        ((4, 6, 5), "int32", "32SC5"),
        ((4, 6, 3), "float32", "32FC3"),
        ((4, 6, 999), "float64", "64FC999"),
        ((4, 6, 1000), "float64", ""),
        ((4, 6, 2), "complex64", ""),
        ((4,), "uint8", ""),
        ((4, 6, 3, 2), "uint8", ""),
        (None, "uint8", ""),
    ],
)
def test_frames_that_declare_no_encoding_have_that_of_their_shape_and_numbers(
    shape: tuple[int, ...] | None, dtype: str, encoding: str
) -> None:
    assert implied_encoding(shape, dtype) == encoding
