# SPDX-License-Identifier: Apache-2.0
"""What only the user can decide about a configuration; `cm build configure` asks for it.

The file (``answers.yaml`` in the output folder, or any given) is a flat map, so that it can be written by hand:

    default_mode: edge_detection
    static_overlay: true
    streams.camera.shape: [480, 640, 4]
    streams.camera.dtype: uint8
    registers.edge.threshold: 96
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from cm.design.errors import BuildError
from cm.design.project.model import empty
from cm.frozen import dataclass, field


@dataclass(frozen=True, slots=True)
class StreamAnswer:
    """A stream's frame; None: as in the build schema."""

    shape: tuple[int, ...] | None = None
    dtype: str | None = None
    slots: int | None = None


@dataclass(frozen=True, slots=True)
class Answers:
    """`registers`: defaults by (implementation, register); None and {}: as in the build schema."""

    default_mode: str | None = None
    static_overlay: bool = True
    streams: Mapping[str, StreamAnswer] = field(default_factory=empty)
    registers: Mapping[tuple[str, str], int] = field(default_factory=empty)


def load_answers(path: Path) -> Answers:
    """Load the answers in a file; none if it does not exist."""
    return parse_answers(read_answers(path), path)


def read_answers(path: Path) -> dict[str, Any]:
    """Read the file's map from question to answer."""
    if not path.exists():
        return {}
    try:
        data = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise BuildError(f"{path}: not YAML: {' '.join(str(error).split())}") from None
    if data is None:
        return {}
    if not isinstance(data, dict):
        raise BuildError(f"{path}: expected a map of questions to answers, like default_mode: edge")
    return {str(key): value for key, value in data.items()}


def parse_answers(data: Mapping[str, Any], source: Path) -> Answers:
    """Convert the flat map to answers. Raises BuildError with the key that is not understood."""
    streams: dict[str, dict[str, Any]] = {}
    registers: dict[tuple[str, str], int] = {}
    default_mode: str | None = None
    static_overlay = True
    for key, value in data.items():
        parts = key.split(".")
        if key == "default_mode" and isinstance(value, str):
            default_mode = value
        elif key == "static_overlay" and isinstance(value, bool):
            static_overlay = value
        elif len(parts) == 3 and parts[0] == "streams" and _stream_value(parts[2], value):
            streams.setdefault(parts[1], {})[parts[2]] = tuple(value) if parts[2] == "shape" else value
        elif len(parts) == 3 and parts[0] == "registers" and _whole(value):
            registers[parts[1], parts[2]] = value
        else:
            raise BuildError(f"{at_key(source, key)}: {value!r} answers none of the questions")
    return Answers(default_mode, static_overlay, {k: StreamAnswer(**v) for k, v in streams.items()}, registers)


def at_key(source: Path, key: str) -> str:
    """Return ``file:line: key``; without the line if no line of the file begins with the key."""
    try:
        lines = source.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError):
        lines = []
    number = next((number for number, line in enumerate(lines, 1) if line.startswith(f"{key}:")), None)
    return f"{source}:{number}: {key}" if number else f"{source}: {key}"


def _whole(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= 0


def _stream_value(key: str, value: object) -> bool:
    if key == "shape":
        return isinstance(value, (list, tuple)) and bool(value) and all(_whole(size) and size > 0 for size in value)
    if key == "dtype":
        return isinstance(value, str)
    return key == "slots" and _whole(value) and isinstance(value, int) and value >= 2
