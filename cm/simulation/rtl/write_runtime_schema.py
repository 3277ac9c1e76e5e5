# SPDX-License-Identifier: Apache-2.0
"""``python -m cm.simulation.rtl.write_runtime_schema BUILD FOLDER``: that which `cm build` makes of a build schema.

A manager has it written by a process of its own: what reads the HDL is 40 MiB that it would keep.
"""

from __future__ import annotations

import logging
import subprocess
import sys
from pathlib import Path

from cm import child
from cm.errors import CmError
from cm.simulation.rtl.errors import RtlError

_LOG = logging.getLogger("cm")


def written(build: Path, folder: Path) -> Path:
    """The file ``<project>.yaml`` in a folder. Raises RtlError with what is wrong with the build schema or its HDL."""
    command = child.command("cm.simulation.rtl.write_runtime_schema", str(build), str(folder))
    done = subprocess.run(
        command, env=child.environment(), stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise RtlError(done.stderr.strip())
    path, *refused = done.stdout.splitlines()
    if refused:
        more = f"; {len(refused) - 1} more: cm build check {build}" if refused[1:] else ""
        _LOG.warning("cm build generate refuses this design, which is simulated all the same: %s%s", refused[0], more)
    return Path(path)


def _write(build: Path, folder: Path) -> tuple[Path, list[str]]:
    """The file, and in a line each what `cm build generate` would refuse."""
    from cm.design.check.rules import check_system
    from cm.design.generate.generation import load_design
    from cm.design.generate.outputs import render_schema
    from cm.design.runtime.answers import Answers

    system = load_design(build).system
    folder.mkdir(mode=0o750, parents=True, exist_ok=True)
    path = folder / f"{system.project.name}.yaml"
    path.write_text(render_schema(system, Answers()), encoding="utf-8")
    findings = check_system(system)
    return path, [" ".join(one.text(system.project.source).split()) for one in findings if one.error]


if __name__ == "__main__":
    try:
        made, told = _write(Path(sys.argv[1]), Path(sys.argv[2]))
        print(made, *told, sep="\n")
    except (CmError, OSError) as error:
        sys.exit(str(error))
