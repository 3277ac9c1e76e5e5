# SPDX-License-Identifier: Apache-2.0
"""Checks that bitstreams belong to one locked static part, and that it is the present one."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Sequence
from pathlib import Path

from cm.design.collect.images import Image
from cm.design.errors import BuildError
from cm.design.plan.system import System

_IN_VERILOG = re.compile(r"\.STATIC_ID\(32'h([0-9A-Fa-f]{8})\)")


def user_id_of(images: Sequence[Image], generated: Path) -> tuple[int | None, list[str]]:
    """Return the USERID of the flow that made `images`, with notes; None if their headers have none.

    Raises BuildError if they belong to several, or not to the locked static part below `generated`, if there is one.
    """
    told = {image.path.name: image.report.user_id for image in images if image.report.header}
    groups: dict[int | None, list[str]] = {}
    for name, user_id in told.items():
        groups.setdefault(user_id, []).append(name)
    if len(groups) > 1:
        each = "; ".join(f"{_shown(user_id)}: {', '.join(names)}" for user_id, names in groups.items())
        raise BuildError(f"bitstreams of several runs of the flow, by their USERID: {each}")
    found = next(iter(groups), None)
    checkpoint = generated / "checkpoints/static_routed.dcp"
    if told and checkpoint.is_file() and found != (expected := user_id_from(checkpoint)):
        raise BuildError(
            f"bitstreams of another static part: their USERID is {_shown(found)}, {checkpoint} gives {expected:08X}"
        )
    return found, _notes(images, found)


def user_id_from(checkpoint: Path) -> int:
    """Compute the USERID from the checkpoint of the locked static part, as the flow's ``cm_user_id`` does."""
    value = int.from_bytes(hashlib.sha256(checkpoint.read_bytes()).digest()[:4], "big")
    return min(value, 0xFFFF_FFFE)  # all ones: not set


def check_generated(system: System, generated: Path) -> None:
    """BuildError if the generated static part does not have the identity that the build schema gives."""
    path = generated / "hdl/cm_static.v"
    found = _IN_VERILOG.search(path.read_text(encoding="utf-8")) if path.is_file() else None
    if found and int(found[1], 16) != system.static_identity:
        raise BuildError(
            f"{path} is of another static part: its identity is {int(found[1], 16):#010x}, "
            f"{system.project.source.name} and its files give {system.static_identity:#010x}: "
            "cm build generate, then run the flow"
        )


def _notes(images: Sequence[Image], found: int | None) -> list[str]:
    silent = [image.path.name for image in images if not image.report.header]
    notes = [f"{', '.join(silent)}: no header, so the run that made it is not known"] if silent else []
    if found is None and len(silent) < len(images):
        notes.append("the bitstreams have no USERID: whether they share a locked static part is not known")
    return notes


def _shown(user_id: int | None) -> str:
    return "none" if user_id is None else f"{user_id:08X}"
