# SPDX-License-Identifier: Apache-2.0
"""The inputs and the result of `cm build collect`.

The target folder ``<config>/`` (as it goes to /lib/firmware/cm/) and an archive of it, the same bytes each time.

Overlay sources → .dtbo, by dtc if it is installed.
"""

from __future__ import annotations

import gzip
import io
import shutil
import subprocess
import tarfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from cm.design.collect.handoff import Handoff
from cm.design.collect.images import Image
from cm.design.errors import BuildError
from cm.design.generate.output_tree import write_whole
from cm.schema.model import Config

HEAD = "# SPDX-License-Identifier: Apache-2.0\n# Written by cm build collect.\n"


@dataclass(frozen=True, slots=True)
class Collected:
    """A configuration ready for the target: `files` lie flat in ``/lib/firmware/cm/<config>/``."""

    config: Config
    files: Mapping[str, bytes]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Inputs:
    """Descriptions and bitstreams that were given."""

    handoffs: tuple[Handoff, ...]
    images: tuple[Image, ...]

    @property
    def whole(self) -> Handoff | None:
        """The description of the whole design, if there is one; BuildError if there are several."""
        found = [entry for entry in self.handoffs if not entry.partial]
        if len(found) > 1:
            raise BuildError(f"several whole designs: {', '.join(entry.name for entry in found)}; give one at a time")
        return found[0] if found else None


def write_folder(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write `files` into `folder`; names that would lead out of it are refused, and its other files stay."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, data in files.items():
        if Path(name).name != name:
            raise BuildError(f"{name!r} is not a plain file name")
        write_whole(folder / name, data)


def archive(name: str, files: Mapping[str, bytes]) -> bytes:
    """A .tar.gz with ``<name>/…``: sorted, without times and owners."""
    packed = io.BytesIO()
    with gzip.GzipFile("", "wb", 9, packed, 0) as zipped, tarfile.open(None, "w", zipped) as tar:
        for path, data in sorted(files.items()):
            info = tarfile.TarInfo(f"{name}/{path}")
            info.mode, info.size = 0o644, len(data)
            tar.addfile(info, io.BytesIO(data))
    return packed.getvalue()


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
