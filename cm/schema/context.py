# SPDX-License-Identifier: Apache-2.0
"""What all parts of building a configuration share: positions in the file, and where problems are reported."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from cm.schema.problems import KeyPath

STATIC = "static"  # what `region:` says for the static part
IMPLIED_REGION = "prr0"
IMAGE_KEYS = ("bitstream", "sha256", "loader", "timeout", "allow_encrypted")  # of a full configuration


@dataclass(frozen=True, slots=True)
class Owner:
    """Where registers belong: the configuration, or one of its modules or modes."""

    path: KeyPath
    region: str | None  # for registers that name no region


@dataclass(slots=True)
class Context:
    """`report(path, code, message, hint)`; `where` has a register's path by its owner's path and its name.

    A memory's path is there too, by `memory_key`, since a memory and a register may have the same name.
    """

    report: Callable[[KeyPath, str, str, str], None]
    where: dict[tuple[KeyPath, str], KeyPath] = field(default_factory=dict)


def memory_key(owner: KeyPath, name: str) -> tuple[KeyPath, str]:
    """The key of a memory in `Context.where`."""
    return (*owner, "memories"), name
