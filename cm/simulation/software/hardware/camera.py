# SPDX-License-Identifier: Apache-2.0
"""The picture that the simulated camera takes: pure functions, so that a test can repeat them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import TypeAlias

from cm.extras import installing
from cm.simulation.software.errors import SimError
from cm.wire.lazy_numpy import NDArray, np

Photo: TypeAlias = "NDArray[np.uint8]"

SHAPE = (480, 640)
MAX_RADIUS = 15
MAX_ZOOM = 16
_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")


def shipped_photos() -> dict[str, Photo]:
    """The photographs of the package by name, (480, 640) each; their rights are in cm/data/photos/README.md."""
    path = Path(__file__).resolve().parents[3] / "data" / "photos" / "photos.npz"
    with np.load(path) as archive:
        return {name: archive[name] for name in archive.files}


def load_photos(folder: Path) -> dict[str, Photo]:
    """A folder's pictures (PNG, JPEG, …) in the order of their names, turned to grey.

    Raises:
        SimError: Pillow is missing, the folder cannot be read, or has no picture, or one cannot be read.
    """
    try:
        from PIL import Image
    except ImportError as error:
        raise SimError(f"--images needs Pillow: {installing('demo')}") from error
    try:
        found = sorted(p for p in folder.iterdir() if p.suffix.lower() in _SUFFIXES)
    except OSError as error:
        raise SimError(f"{folder} cannot be read as a folder of pictures: {error.strerror}") from error
    if not found:
        raise SimError(f"{folder} has no pictures; wanted are files ending in {', '.join(_SUFFIXES)}")
    photos = {}
    for path in found:
        try:
            with Image.open(path) as image:
                photos[path.name] = np.asarray(image.convert("L"))
        except OSError as error:
            raise SimError(f"{path} cannot be read as a picture: {error}") from error
    return photos


def resize(photo: Photo, shape: tuple[int, int]) -> Photo:
    """Nearest neighbour: pixel (r, c) of the result is (r·H // h, c·W // w) of the photo."""
    if photo.shape == shape:
        return photo
    rows = np.arange(shape[0]) * photo.shape[0] // shape[0]
    columns = np.arange(shape[1]) * photo.shape[1] // shape[1]
    return np.ascontiguousarray(photo[rows][:, columns])


def blur(photo: Photo, radius: int) -> Photo:
    """Mean of the (2·radius + 1)² neighbours, rounded down; the border pixels repeat outwards."""
    if radius <= 0:
        return photo
    size = 2 * radius + 1
    padded = np.pad(photo, radius, mode="edge")
    total = np.zeros((padded.shape[0] + 1, padded.shape[1] + 1), np.uint32)
    np.cumsum(padded, axis=0, dtype=np.uint32, out=total[1:, 1:])
    np.cumsum(total[1:, 1:], axis=1, out=total[1:, 1:])
    box = total[size:, size:] - total[:-size, size:] - total[size:, :-size] + total[:-size, :-size]
    return (box // (size * size)).astype(np.uint8)


def zoom_in(photo: Photo, zoom: int) -> Photo:
    """The centre, 1/zoom of each side, enlarged to the photo's size by nearest neighbour."""
    if zoom <= 1:
        return photo
    height, width = max(1, photo.shape[0] // zoom), max(1, photo.shape[1] // zoom)
    top, left = (photo.shape[0] - height) // 2, (photo.shape[1] - width) // 2
    return resize(photo[top : top + height, left : left + width], (photo.shape[0], photo.shape[1]))


def frame(photo: Photo, shape: tuple[int, int] = SHAPE, focus: int = 1, zoom: int = 1) -> Photo:
    """What leaves the sensor: resized to `shape`, blurred by |focus - 1| pixels, then zoomed in.

    `focus` is limited to 0…16 and `zoom` to 1…16, as by the lens.
    """
    radius = min(abs(focus - 1), MAX_RADIUS)
    return zoom_in(blur(resize(photo, shape), radius), min(max(zoom, 1), MAX_ZOOM))


class PhotoReel:
    """The photo in front of the lens: each for `hold` frames; 0: always the first."""

    def __init__(self, photos: Sequence[Photo] | None, hold: int) -> None:
        """`photos` None: those of the package, read when the first is taken."""
        self._given = photos
        self._hold = hold
        self.taken = 0
        self._last: tuple[tuple[int, ...], Photo] | None = None

    @cached_property
    def _photos(self) -> Sequence[Photo]:
        return list(shipped_photos().values()) if self._given is None else self._given

    @property
    def index(self) -> int:
        """Index of the photo that the next frame shows."""
        return self.taken // self._hold % len(self._photos) if self._hold and self.taken else 0

    def take(self, shape: tuple[int, int], focus: int, zoom: int) -> Photo:
        """The next frame; the same as the last is not computed again."""
        key = (self.index, *shape, focus, zoom)
        self.taken += 1
        if self._last is None or self._last[0] != key:
            self._last = (key, frame(self._photos[key[0]], shape, focus, zoom))
        return self._last[1]
