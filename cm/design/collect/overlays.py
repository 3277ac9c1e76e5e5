# SPDX-License-Identifier: Apache-2.0
"""Overlay sources → .dtbo, by dtc if it is installed."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Mapping

from cm.design.errors import BuildError

# the base tree's cells are not known when an overlay is compiled
QUIET = (
    "-Wno-ranges_format",
    "-Wno-avoid_default_addr_size",
    "-Wno-reg_format",
    "-Wno-interrupts_property",
    # a DMA channel's unit address is that of its registers; the reg property is the engine's
    "-Wno-unit_address_vs_reg",
    # a window for user space may also be that of a bridge that the kernel drives
    "-Wno-unique_unit_address",
)


def compile_overlays(sources: Mapping[str, str]) -> tuple[dict[str, bytes], list[str]]:
    """``<name>.dtbo`` files, and notes; without dtc the sources are kept and a note says so."""
    dtc = shutil.which("dtc")
    if dtc is None and sources:
        note = "dtc is not installed: the overlays are left as .dtso, compile them with dtc -@ -O dtb"
        return {f"{name}.dtso": text.encode() for name, text in sources.items()}, [note]
    return {f"{name}.dtbo": _compile(str(dtc), name, text) for name, text in sources.items()}, []


def _compile(dtc: str, name: str, text: str) -> bytes:
    command = [dtc, "-@", *QUIET, "-I", "dts", "-O", "dtb", "-"]
    done = subprocess.run(command, input=text.encode(), capture_output=True, check=False)
    if done.returncode:
        raise BuildError(f"dtc refuses {name}.dtso: {done.stderr.decode(errors='replace').strip()}")
    return done.stdout
