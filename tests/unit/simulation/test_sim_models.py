# SPDX-License-Identifier: Apache-2.0
"""The simulator's software models and its camera against independent implementations."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from cm.schema.model import Config, Module, Region
from cm.simulation.software import SimError
from cm.simulation.software.hardware import camera
from cm.simulation.software.hardware.models import Colorise, Models, default, edge

GX = ((-1, 0, 1), (-2, 0, 2), (-1, 0, 1))
GY = ((-1, -2, -1), (0, 0, 0), (1, 2, 1))

QUICK = settings(max_examples=50, deadline=None, suppress_health_check=[HealthCheck.too_slow])  # of a busy machine
pictures = arrays(np.uint8, st.tuples(st.integers(1, 9), st.integers(1, 9)))


def sobel_pixel(picture: np.ndarray, row: int, column: int) -> int:
    """The definition, one pixel at a time."""
    if row in (0, picture.shape[0] - 1) or column in (0, picture.shape[1] - 1):
        return 0
    near = [[int(picture[row + i - 1, column + j - 1]) for j in range(3)] for i in range(3)]
    gx = sum(GX[i][j] * near[i][j] for i in range(3) for j in range(3))
    gy = sum(GY[i][j] * near[i][j] for i in range(3) for j in range(3))
    return min(255, abs(gx) + abs(gy))


def sobel(picture: np.ndarray, threshold: int = 0) -> np.ndarray:
    result = np.zeros_like(picture)
    for row in range(picture.shape[0]):
        for column in range(picture.shape[1]):
            value = sobel_pixel(picture, row, column)
            result[row, column] = value if value >= threshold else 0
    return result


@given(pictures, st.integers(0, 300))
@QUICK
def test_edge_is_the_sobel_magnitude_saturated_with_zero_borders(picture, threshold):
    assert np.array_equal(edge(picture, {"threshold": threshold}), sobel(picture, threshold))


def test_edge_of_a_photograph_is_the_sobel_magnitude_at_sampled_pixels():
    photo = camera.shipped_photos()["astronaut"]
    result = edge(photo, {})
    for row, column in [(0, 5), (1, 1), (100, 200), (240, 320), (478, 638), (479, 639), (333, 77)]:
        assert result[row, column] == sobel_pixel(photo, row, column)


def test_default_copies_nothing():
    picture = np.zeros((4, 4), np.uint8)
    assert default(picture, {}) is picture


def reference_colour(value: int, palette: int) -> list[int]:
    clip = lambda x: max(0, min(255, x))  # noqa: E731
    heat = [clip(3 * value), clip(3 * value - 255), clip(3 * value - 510)]
    rainbow = [clip(255 - abs(4 * value - peak)) for peak in (765, 510, 255)]
    return [heat, heat[::-1], rainbow, [value] * 3][palette % 4]


@pytest.mark.parametrize("palette", [0, 1, 2, 3, 4])
def test_colorise_gives_three_bytes_of_the_documented_palette(palette):
    ramp = np.arange(256, dtype=np.uint8).reshape(16, 16)
    result = Colorise()(ramp, {"palette": palette})
    assert result.shape == (16, 16, 3)
    assert result.reshape(-1, 3).tolist() == [reference_colour(v, palette) for v in range(256)]


def test_an_unknown_model_passes_data_unchanged():
    assert Models.standard().get("nobody_knows") is default


def test_what_packages_offer_is_looked_for_only_where_a_model_is_not_here(monkeypatch):
    looked = []
    monkeypatch.setattr("importlib.metadata.entry_points", lambda **group: looked.append(group) or [])
    models = Models.standard()
    models.load_entry_points()
    regions = {"left": Region("left"), "right": Region("right")}
    modules = {"edge": Module("edge", "left", model="edge"), "turn_right": Module("turn_right", "right", model="turn")}
    models.check([Config("here", regions=regions, modules=modules), Config("none", regions=regions)])
    assert not looked
    with pytest.raises(SimError, match="no model is called 'egde', did you mean 'edge'"):
        models.check([Config("there", regions=regions, modules={"egde": Module("egd", "left", model="egde")})])
    assert len(looked) == 1


def test_models_of_a_users_file_are_added(tmp_path):
    (tmp_path / "mine.py").write_text("MODELS = {'invert': lambda frame, registers: 255 - frame}\n")
    models = Models.standard()
    models.load(str(tmp_path / "mine.py"))
    assert models.get("invert")(np.array([[1, 2]], np.uint8), {}).tolist() == [[254, 253]]


def test_a_file_without_models_is_refused_with_what_is_missing(tmp_path):
    (tmp_path / "mine.py").write_text("x = 1\n")
    with pytest.raises(SimError, match="MODELS"):
        Models.standard().load(str(tmp_path / "mine.py"))


@given(pictures, st.integers(1, 4))
@QUICK
def test_blur_is_the_mean_of_the_neighbours_with_repeated_borders(picture, radius):
    height, width = picture.shape
    expected = np.zeros_like(picture)
    for row in range(height):
        for column in range(width):
            near = [
                int(picture[min(max(row + i, 0), height - 1), min(max(column + j, 0), width - 1)])
                for i in range(-radius, radius + 1)
                for j in range(-radius, radius + 1)
            ]
            expected[row, column] = sum(near) // len(near)
    assert np.array_equal(camera.blur(picture, radius), expected)


def test_zoom_shows_the_centre_larger():
    picture = np.arange(64, dtype=np.uint8).reshape(8, 8)
    result = camera.zoom_in(picture, 2)
    assert result.shape == (8, 8)
    assert result[0, 0] == result[1, 1] == picture[2, 2]
    assert result[7, 7] == picture[5, 5]


def test_focus_one_is_sharp_and_either_side_of_it_is_blurred_alike():
    photo = camera.shipped_photos()["coffee"]
    assert np.array_equal(camera.frame(photo, focus=1), photo)
    assert np.array_equal(camera.frame(photo, focus=0), camera.frame(photo, focus=2))
    assert np.array_equal(camera.frame(photo, focus=4), camera.blur(photo, 3))


@given(pictures, st.tuples(st.integers(1, 12), st.integers(1, 12)))
@QUICK
def test_resize_takes_the_nearest_pixel(picture, shape):
    result = camera.resize(picture, shape)
    for row in range(shape[0]):
        for column in range(shape[1]):
            source = picture[row * picture.shape[0] // shape[0], column * picture.shape[1] // shape[1]]
            assert result[row, column] == source


def test_the_shipped_photographs_are_real_grey_pictures():
    photos = camera.shipped_photos()
    assert len(photos) == 3
    for photo in photos.values():
        assert photo.shape == camera.SHAPE
        assert photo.dtype == np.uint8
        assert len(np.unique(photo)) > 200


def test_a_reel_holds_each_photo_for_its_frames_and_then_shows_the_next():
    photos = [np.full((2, 2), value, np.uint8) for value in (10, 20)]
    reel = camera.PhotoReel(photos, hold=2)
    assert [int(reel.take((2, 2), 1, 1)[0, 0]) for _ in range(5)] == [10, 10, 20, 20, 10]


def test_a_reel_without_hold_shows_the_first_for_ever():
    photos = [np.full((2, 2), value, np.uint8) for value in (10, 20)]
    reel = camera.PhotoReel(photos, hold=0)
    assert {int(reel.take((2, 2), 1, 1)[0, 0]) for _ in range(200)} == {10}


def test_a_folder_of_pictures_is_read_in_the_order_of_names(tmp_path):
    image = pytest.importorskip("PIL.Image")
    for name, value in (("b.png", 20), ("a.png", 10)):
        image.fromarray(np.full((3, 4, 3), value, np.uint8)).save(tmp_path / name)
    photos = camera.load_photos(tmp_path)
    assert [(name, int(photo[0, 0]), photo.shape) for name, photo in photos.items()] == [
        ("a.png", 10, (3, 4)),
        ("b.png", 20, (3, 4)),
    ]


def test_an_empty_folder_of_pictures_is_refused(tmp_path):
    pytest.importorskip("PIL")
    with pytest.raises(SimError, match="no pictures"):
        camera.load_photos(tmp_path)


def test_a_folder_of_pictures_that_cannot_be_read_is_not_called_empty(tmp_path):
    pytest.importorskip("PIL")
    with pytest.raises(SimError, match="absent cannot be read as a folder of pictures: No such file"):
        camera.load_photos(tmp_path / "absent")
