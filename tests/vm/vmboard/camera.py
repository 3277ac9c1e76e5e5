# SPDX-License-Identifier: Apache-2.0
"""The camera configuration of the virtual board as an archive, packed as `cm build collect` packs it."""

from __future__ import annotations

import subprocess
import sys

from vmboard.paths import REPOSITORY

SCHEMA = REPOSITORY / "tests/vm/guest/system/camera.yaml"
MODULES = {"default": 0, "edge": 0, "colorise": 0, "loopback": 1}  # and the index of their region
SIZE = 16 * 1024  # bytes of a bitstream: an emulated processor looks at each word
_PACK = """
import sys
from cm.formats.bitstream import assemble_module
from cm.design.collect.collected import archive
name, schema, size, modules = sys.argv[1], sys.argv[2], int(sys.argv[3]), sys.argv[4:]
files = {f"{m}.bit": assemble_module(m, region_index=int(i), size=size) for m, i in (e.split("=") for e in modules)}
sys.stdout.buffer.write(archive(name, {f"{name}.yaml": schema.encode(), **files}))
"""


def archive(name: str = "camera") -> bytes:
    """The archive, without overlays, which Debian's kernel cannot apply."""
    lines = SCHEMA.read_text().splitlines(keepends=True)
    schema = "".join(line for line in lines if "overlays:" not in line).replace("name: camera", f"name: {name}", 1)
    modules = [f"{module}={index}" for module, index in MODULES.items()]
    command = [sys.executable, "-c", _PACK, name, schema, str(SIZE), *modules]
    return subprocess.run(command, cwd=REPOSITORY, stdout=subprocess.PIPE, check=True).stdout
