# SPDX-License-Identifier: Apache-2.0
"""Describe the compiled module ``cm.device.native._cm`` to cffi (out-of-line API mode, abi3).

A C unit is three files: ``csrc/<unit>.c``, ``csrc/<unit>.h`` and ``csrc/cffi/<unit>.h``, the part of
its header that Python calls, in cffi's dialect (``...`` where the compiler knows better).  Adding
the three adds the unit; nothing has to be listed here.  A ``.c`` without a cdef is compiled in as well.
"""

from __future__ import annotations

import os
from pathlib import Path

from cffi import FFI

HERE = Path(__file__).parent
UAPI = HERE.parent / "kmod" / "uapi"


def _relative(path: Path) -> str:
    """Return ``path`` as setuptools wants it: relative to setup.py, with forward slashes."""
    return Path(os.path.relpath(path)).as_posix()


def _builder() -> FFI:
    cdefs = sorted((HERE / "cffi").glob("*.h"))
    headers = sorted([*HERE.glob("*.h"), *UAPI.glob("*.h"), *cdefs])
    ffi = FFI()
    for cdef in cdefs:
        ffi.cdef(cdef.read_text(encoding="utf-8"))
    ffi.set_source(
        "cm.device.native._cm",
        "".join(f'#include "{cdef.name}"\n' for cdef in cdefs),
        sources=[_relative(path) for path in sorted(HERE.glob("*.c"))],
        include_dirs=[_relative(HERE), _relative(UAPI)],
        depends=[_relative(path) for path in headers],
        define_macros=[("_GNU_SOURCE", None), ("_FILE_OFFSET_BITS", "64")],  # 32-bit userland sees 64-bit inodes too
        # no path of the building machine in the module: it is the same from whatever folder it is built
        extra_compile_args=["-std=gnu11", "-O2", "-fvisibility=hidden", f"-ffile-prefix-map={Path.cwd()}=."],
        extra_link_args=["-pthread"],
        py_limited_api=True,
    )
    return ffi


ffibuilder = _builder()
