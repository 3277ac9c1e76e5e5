# SPDX-License-Identifier: Apache-2.0
"""What a manager imports while it works: on a board with 512 MB it stays small only without what it does not need."""

from __future__ import annotations

import subprocess
import sys

from manager_process import environment, served

# numpy alone takes 11 MiB, importlib.resources 2, shutil (with bz2 and lzma) 0.6.
HEAVY = {"asyncio", "bz2", "ctypes", "email", "http", "importlib.resources", "lzma", "multiprocessing", "shutil"}
HEAVY |= {"sqlite3", "ssl", "statistics", "tempfile", "unittest", "xml", "zipfile"}
LIBRARIES = {"_cffi_backend", "_yaml", "cm", "google", "yaml", "zmq"}
# By Python itself, where there are any; Debian 13's sitecustomize looks for the last.
STARTED_WITH = {"_distutils_hack", "sitecustomize", "usercustomize", "apport_python_hook"}
_ELSEWHERE = {"org", "win32api", "cPickle", "_wmi"}  # of other systems and times: libraries try to import them


def imported(log: bytes) -> set[str]:
    """Modules in what Python says with PYTHONPROFILEIMPORTTIME."""
    lines = log.decode(errors="replace").splitlines()
    return {line.rpartition("|")[2].strip() for line in lines if line.startswith("import time:")} - {"imported package"}


def _by_zmq() -> set[str]:
    """What pyzmq imports itself: ctypes, until 25."""
    command = [sys.executable, "-X", "importtime", "-c", "import zmq"]
    return imported(subprocess.run(command, check=True, capture_output=True).stderr)


def test_a_manager_that_works_imports_no_arrays_and_no_library_it_does_not_need() -> None:
    with served(env={**environment(), "PYTHONPROFILEIMPORTTIME": "1"}) as (manager, _), manager.connected() as board:
        board.load("camera", "default")
        board.plan("edge_detection")
        board.mode = "edge_detection"
        board.registers["focus"] = 3
        assert board.registers["focus"] == 3
        assert board.read("camera", timeout=60).shape
        board.mode = "loopback"
        assert board.mode == "loopback"
    modules = imported(manager.log)
    assert {"cm.formats.bitstream.inspect", "cm.server.streams.channel_setup", "cm.wire.cm_pb2"} <= modules
    assert not modules & (HEAVY - _by_zmq())
    tops = {name.partition(".")[0] for name in modules} - sys.stdlib_module_names - STARTED_WITH - _ELSEWHERE
    assert tops <= LIBRARIES
    assert not {
        name
        for name in modules
        if name.startswith(("cm.client", "cm.simulation.software", "cm.design", "cm.tools.bench"))
    }
