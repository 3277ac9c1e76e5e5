# SPDX-License-Identifier: Apache-2.0
"""Which boards were good, and for what state of the tree: those whose turn can wait are left out until it differs.

The record is a file of the tree, written by every run that was good; whoever runs a board commits it.
"""

from __future__ import annotations

import datetime
import json
import os
from pathlib import Path

from vmboard.cache import digest, source_files
from vmboard.paths import REPOSITORY
from vmboard.tiers import TIERS, Tier

RECORD = REPOSITORY / "tests/vm/good.json"
# Those that run each time: one on Debian's kernel, one on the kernel's own drivers, one with our packages.
ALWAYS = ("stock", "silicon", "service")
TESTED = (
    "kmod",
    "dts",
    "tests/device",
    *(f"tests/vm/{part}" for part in ("cases", "guest", "kernel", "trees")),
)
SHIM, WIRE, HOST_ONLY = "csrc", "cm_plane_wire.h", ("client", "tests")  # what the host's own suites build and run
OWN = {"silicon-6.12": ("tests/vm/silicon",), "zynq": ("tests/vm/silicon",), "remote": ("tests/vm/remote",)}
# What takes the place of a part of the tree: a run with it tells nothing of the tree.
SUBSTITUTES = ("CM_VM_KMOD", "CM_VM_DRIVER", "CM_VM_QEMU_ARM")


def waits(tier: Tier) -> bool:
    """Whether a board has its turn only when what it tests has changed."""
    return not (tier.name in ALWAYS or tier.optional or tier.kvm)


def state(tier: Tier, tree: Path = REPOSITORY) -> str:
    """A hash of what a board tests: the tier's own description, and the sources."""
    return digest(repr(tier), *(tree / part for part in (*TESTED, *OWN.get(tier.name, ()))), *_shim(tree))


def _shim(tree: Path) -> list[Path]:
    """The sources of the shim, with the packets of the data socket that clients in C share with it."""
    return [path for path in source_files(tree / SHIM) if path.name == WIRE or path.parent.name not in HOST_ONLY]


def unchanged_since(tier: Tier, record: Path = RECORD, tree: Path = REPOSITORY) -> str:
    """The day of the last good run, if it was of this state; empty: it was of another, or there was none."""
    known = _read(record).get(tier.name, {})
    return known.get("day", "") if known.get("state") == state(tier, tree) else ""


def good(tier: Tier, record: Path = RECORD, tree: Path = REPOSITORY) -> None:
    """Note that all of a board's tests passed just now."""
    if not waits(tier) or any(os.environ.get(name) for name in SUBSTITUTES):
        return
    known = {name: entry for name, entry in _read(record).items() if name in TIERS}  # a board may be there no more
    today = datetime.datetime.now(datetime.timezone.utc).date()
    known[tier.name] = {"state": state(tier, tree), "day": today.isoformat()}
    text = json.dumps(dict(sorted(known.items())), indent=2) + "\n"
    if not record.exists() or record.read_text() != text:
        record.write_text(text)


def _read(record: Path) -> dict[str, dict[str, str]]:
    known: dict[str, dict[str, str]] = json.loads(record.read_text()) if record.exists() else {}
    return known
