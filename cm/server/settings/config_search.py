# SPDX-License-Identifier: Apache-2.0
"""The configurations along the search path of the settings."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

from cm.errors import CmError
from cm.frozen import dataclass
from cm.schema import load, schema_files
from cm.schema.model import Config


@dataclass(frozen=True, slots=True)
class Found:
    """Configurations by name, and a sentence for each schema that was left out."""

    configs: dict[str, Config]
    left_out: tuple[str, ...]


def find_configs(places: Iterable[str]) -> Found:
    """The configurations in the files and folders at `places`, in order; ``*`` stands for any folder.

    Of several with one name the first counts. One bad file must not keep a board from starting: it is left out, with a
    sentence that names it.
    """
    configs: dict[str, Config] = {}
    left_out = []
    for file in _files(places):
        try:
            config = load(file)
        except (CmError, OSError) as error:
            left_out.append(str(error))
            continue
        first = configs.setdefault(config.name, config)
        if first is not config:
            left_out.append(f"{file}: configuration {config.name} comes from {first.source}, which is found first")
    return Found(configs, tuple(left_out))


def _files(places: Iterable[str]) -> Iterator[Path]:
    for place in places:
        for path in sorted(Path("/").glob(place.lstrip("/"))):
            if path.name.startswith("."):  # of an import under way, or kept for a rollback
                continue
            if path.is_dir():
                yield from schema_files(path)
            elif path.exists():
                yield path
