# SPDX-License-Identifier: Apache-2.0
"""``cm stream capture``: frames to files or standard output, each file complete after each frame."""

from __future__ import annotations

import argparse
import io
import math
import os
import signal
import sys
from collections.abc import Callable, Iterable
from contextlib import redirect_stdout, suppress
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Protocol, TypeVar

from cm.cli.common import binary_output, named, natural, own_lease, print_json, write_whole
from cm.cli.connection import connected
from cm.cli.failures import EXIT_INTERRUPTED
from cm.errors import CmError, InvalidRequest, Timeout
from cm.extras import installing

if TYPE_CHECKING:
    import numpy as np

    from cm.client.board import Board
    from cm.client.stream import Stream
else:
    from cm.wire.lazy_numpy import np

_HEADER = 128  # bytes of a .npy header with room for any number of frames: written anew with each
FORMATS = ("npy", "png", "raw")


class Incomplete(CmError):
    """A frame could not be written; those before it were."""

    code = "io"


class Sink(Protocol):
    """Where frames go."""

    files: list[str]

    def add(self, frame: np.ndarray[Any, Any]) -> str:
        """Write one; a remark for people, if there is one. Raises OSError; what was written before stays whole."""

    def close(self) -> None:
        """No more."""


class NpyFiles:
    """Frames along the first axis of a .npy file (`alone`: one frame, as it is); another shape begins another file."""

    def __init__(self, path: Path, alone: bool) -> None:
        self.files: list[str] = []
        self._path, self._alone = path, alone
        self._file: IO[bytes] | None = None
        self._like: tuple[Any, ...] = ()
        self._count = 0

    def add(self, frame: np.ndarray[Any, Any]) -> str:
        remark = ""
        if self._file is not None and self._like != (frame.shape, frame.dtype):
            remark = f"frames of {frame.shape} {frame.dtype} go on in another file"
            self.close()
        if self._file is None:
            self._begin(frame)
        self._append(frame)
        return remark

    def _begin(self, frame: np.ndarray[Any, Any]) -> None:
        number = len(self.files) + 1
        path = self._path if number == 1 else self._path.with_name(f"{self._path.stem}-{number}{self._path.suffix}")
        self._file = path.open("wb", buffering=0)
        self.files.append(str(path))
        self._like, self._count = (frame.shape, frame.dtype), 0
        self._tell()

    def _append(self, frame: np.ndarray[Any, Any]) -> None:
        assert self._file is not None
        _append(self._file, frame, _HEADER + self._count * frame.nbytes)
        self._count += 1
        self._tell()

    def _tell(self) -> None:
        """Overwrites the old header, which works on a full disk too."""
        assert self._file is not None
        shape, dtype = self._like
        text = f"{{'descr': {np.lib.format.dtype_to_descr(dtype)!r}, 'fortran_order': False, 'shape': "
        text += f"{shape if self._alone else (self._count, *shape)!r}, }}"
        body = text.ljust(_HEADER - 11).encode() + b"\n"
        os.pwrite(self._file.fileno(), b"\x93NUMPY\x01\x00" + len(body).to_bytes(2, "little") + body, 0)

    def close(self) -> None:
        if self._file is not None:
            self._file.close()
            self._file = None


class PngFiles:
    """A picture for each frame, numbered if there are several; what is not a picture goes into a .npy file beside."""

    def __init__(self, path: Path, alone: bool) -> None:
        self.files: list[str] = []
        self._path, self._alone = path, alone
        self._number = 0

    def add(self, frame: np.ndarray[Any, Any]) -> str:
        path = self._path if self._alone else self._path.with_name(f"{self._path.stem}-{self._number:04d}.png")
        self._number += 1
        if not is_picture(frame):
            return self._beside(path.with_suffix(".npy"), frame)
        self._write(path, png(frame))
        return ""

    def _beside(self, path: Path, frame: np.ndarray[Any, Any]) -> str:
        data = io.BytesIO()
        np.save(data, frame)
        self._write(path, data.getvalue())
        why = "flat bytes, without a shape" if frame.ndim == 1 else f"of shape {frame.shape} {frame.dtype}"
        return f"{path.name}: {why}, is not a picture (`shape:` in the schema says what it is)"

    def _write(self, path: Path, data: bytes) -> None:
        write_whole(path, data)
        self.files.append(str(path))

    def close(self) -> None:
        """Each file is closed already."""


class Raw:
    """The bytes of all frames, one after the other, in a file."""

    def __init__(self, path: Path) -> None:
        self.files: list[str] = []
        self._path = path
        self._file: IO[bytes] | None = None  # until a frame comes, what was there stays
        self._end = 0

    def add(self, frame: np.ndarray[Any, Any]) -> str:
        if self._file is None:
            self._file = self._path.open("wb", buffering=0)
            self.files.append(str(self._path))
        _append(self._file, frame, self._end)
        self._end += frame.nbytes
        return ""

    def close(self) -> None:
        if self._file is not None:
            self._file.close()


class Output:
    """Frames on a stream such as standard output: .npy or .png files one after the other, or bare bytes."""

    def __init__(self, to: IO[bytes], form: str) -> None:
        self.files = ["-"]
        self._to, self._form = to, form

    def add(self, frame: np.ndarray[Any, Any]) -> str:
        if self._form == "raw":
            self._to.write(frame.tobytes())
        elif self._form == "npy":
            data = io.BytesIO()
            np.save(data, frame)
            self._to.write(data.getvalue())
        elif is_picture(frame):
            self._to.write(png(frame))
        else:
            raise InvalidRequest(f"a frame of {frame.shape} {frame.dtype} is not a picture: --format npy, or raw")
        self._to.flush()
        return ""

    def close(self) -> None:
        """It is not ours."""


def sink(file: str, form: str, alone: bool, stdout: IO[bytes]) -> Sink:
    """The writer for a file, by its name. Raises InvalidRequest for a name without a known format."""
    path = Path(file)
    if file == "-":
        return Output(stdout, form or "npy")
    form = form or path.suffix.removeprefix(".")
    if form == "npy":
        return NpyFiles(path, alone)
    if form == "png":
        return PngFiles(path, alone)
    if form == "raw":
        return Raw(path)
    raise InvalidRequest(f"{file}: frames are written as .npy, .png or .raw; --format says which")


def is_picture(frame: np.ndarray[Any, Any]) -> bool:
    """Grey, RGB or RGBA, with lines."""
    pixels = frame.dtype in (np.uint8, np.uint16) and frame.ndim == 2
    return pixels or (frame.dtype == np.uint8 and frame.ndim == 3 and frame.shape[2] in (3, 4))


def png(frame: np.ndarray[Any, Any]) -> bytes:
    """The file. Raises InvalidRequest where Pillow is missing."""
    try:
        from PIL import Image
    except ModuleNotFoundError:
        raise InvalidRequest(f"PNG files need Pillow: {installing('demo')}, or write a .npy file") from None
    data = io.BytesIO()
    Image.fromarray(frame).save(data, "PNG")
    return data.getvalue()


def _append(file: IO[bytes], frame: np.ndarray[Any, Any], end: int) -> None:
    """Write a frame behind the first `end` bytes. Raises OSError; then there are as many as before."""
    view, at = np.ascontiguousarray(frame).data.cast("B"), end
    try:
        while len(view):
            done = os.pwrite(file.fileno(), view, at)
            view, at = view[done:], at + done
    except OSError:
        file.truncate(end)
        raise


_T = TypeVar("_T")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments, except the stream."""
    parser.add_argument(
        "file", metavar="FILE", help="NAME.npy, NAME.png (numbered if several), NAME.raw, or - for standard output"
    )
    parser.add_argument("--count", type=natural, default=1, metavar="N", help="how many frames (1); 0: until Ctrl-C")
    parser.add_argument(
        "--format", choices=FORMATS, default="", help="format, if the file name does not say it (for -: npy)"
    )


def run_capture(args: argparse.Namespace) -> int:
    """Write frames; the exit status. Frames that came before a failure or Ctrl-C are in the files."""
    to = sink(args.file, args.format, args.count == 1, binary_output() if args.file == "-" else sys.stdout.buffer)
    capture = _Capture(to, "standard output" if args.file == "-" else args.file)
    try:
        with (
            connected(args) as board,
            board.stream(args.stream, lease=own_lease()) as stream,
            _Interrupt() as interrupt,
        ):
            try:
                interrupted = capture.take(stream, args.count, interrupt)
            except Timeout as error:
                raise Timeout(f"{error}{_cause(board, args.stream)}") from None
            capture.note(_why_flat(board, args.stream, capture.like))
    except (OSError, Timeout) as error:
        if isinstance(error, BrokenPipeError):
            raise
        if not capture.sequences:
            _remove(to.files)
            raise
        raise Incomplete(f"{error.strerror if isinstance(error, OSError) else error}; {capture.told()}") from error
    finally:
        to.close()
    capture.tell(args.json, sys.stderr if args.file == "-" else sys.stdout)
    return EXIT_INTERRUPTED if interrupted else 0


def _remove(files: Iterable[str]) -> None:
    """Files without a whole frame; a device, or a link to one, is no file of ours."""
    for path in map(Path, files):
        if path.is_file() and not path.is_symlink():
            path.unlink()


def _cause(board: Board, name: str) -> str:
    """Why no frame comes, if the manager knows: a shape that is not that of the packets shows as a failed transfer."""
    failed = (stream.last_error for stream in board.status.streams if stream.name == name)
    return "".join(f": {error.message}" for error in failed if error)


def _why_flat(board: Board, name: str, like: tuple[Any, ...]) -> str:
    """Why frames came as flat bytes, if the stream has another size: what its schema says is not what comes."""
    if not like or len(like[0]) != 1 or like[1] != np.uint8:
        return ""
    for stream in board.status.streams:
        whole = math.prod(stream.shape) * np.dtype(stream.dtype).itemsize
        if stream.name == name and stream.shape and whole != like[0][0]:
            said = f"{'x'.join(map(str, stream.shape))} {stream.dtype}"
            return f"flat, as {like[0][0]} bytes came, and a frame of {said} has {whole}: shape or dtype is another"
    return ""


class _Capture:
    """What was written so far."""

    def __init__(self, to: Sink, file: str) -> None:
        self._to, self._file = to, file
        self.sequences: list[int] = []
        self._remarks: list[str] = []
        self.like: tuple[Any, ...] = ()

    def take(self, stream: Stream, count: int, interrupt: _Interrupt) -> bool:
        """Write `count` frames (0: all); whether Ctrl-C ended it."""
        while not count or len(self.sequences) < count:
            try:
                frame = interrupt.during(stream.read)
            except KeyboardInterrupt:
                return True
            try:
                self.note(self._to.add(np.asarray(frame)))
            except OSError as error:
                raise named(error, self._file) from None
            self.sequences.append(frame.sequence)
            self.like = self.like or (frame.shape, frame.dtype)
            frame.release()
        return False

    def note(self, remark: str) -> None:
        """A remark for people, if there is one."""
        if remark:
            self._remarks.append(remark)

    def told(self) -> str:
        """In a sentence."""
        if not self.sequences:
            return "no frame came"
        number, files = len(self.sequences), self._to.files
        where = ", ".join(files) if len(files) < 4 else f"{files[0]} … {files[-1]}"
        shape, dtype = self.like
        return f"{number} frame{'s' if number > 1 else ''} of {shape} {dtype} in {where}"

    def tell(self, as_json: bool, to: Any) -> None:
        if as_json:
            shape = self.like[0] if self.like else ()
            told = {"files": self._to.files, "sequences": self.sequences, "shape": shape, "remarks": self._remarks}
            with redirect_stdout(to):
                print_json(told)
            return
        print(self.told(), file=to)
        for remark in self._remarks:
            print(f"  {remark}", file=to)


class _Interrupt:
    """Ctrl-C ends the waiting for a frame, never the writing of one."""

    def __init__(self) -> None:
        self._waits = self._asked = False
        self._before: Any = None

    def __enter__(self) -> _Interrupt:
        with suppress(ValueError):  # not in the main thread, where no key press arrives
            self._before = signal.signal(signal.SIGINT, self._pressed)
        return self

    def __exit__(self, *_: object) -> None:
        with suppress(ValueError):
            if self._before is not None:
                signal.signal(signal.SIGINT, self._before)

    def _pressed(self, *_: object) -> None:
        self._asked = True
        if self._waits:
            raise KeyboardInterrupt

    def during(self, wait: Callable[[], _T]) -> _T:
        """What `wait` gives. Raises KeyboardInterrupt."""
        self._waits = True
        try:
            if self._asked:
                raise KeyboardInterrupt
            return wait()
        finally:
            self._waits = False
