# SPDX-License-Identifier: Apache-2.0
"""Python on macOS or Windows, as far as it can be had on Linux: ``python laptop.py win32|darwin SCRIPT ARGUMENT…``.

From here on, imports do not find what the standard library lacks on that system; third-party libraries are imported
before. `sys.platform` names that system. The system itself is not imitated: paths, the event loop, the behaviour of
sockets. Names are those of the library reference ("Availability").
"""

from __future__ import annotations

import runpy
import sys
from collections.abc import Sequence
from importlib import import_module
from types import ModuleType

UNIX_MODULES = ("fcntl", "grp", "pty", "pwd", "resource", "syslog", "termios", "tty")
OURS = ("cm.device.native._cm",)
LINUX = {
    "os": "O_PATH O_TMPFILE eventfd memfd_create pidfd_open sched_getaffinity posix_fallocate epoll timerfd_create",
    "socket": "MSG_CMSG_CLOEXEC MSG_NOSIGNAL SOCK_CLOEXEC SOCK_NONBLOCK AF_NETLINK SO_PEERCRED SO_DOMAIN",
    "mmap": "MAP_POPULATE",
    "select": "epoll EPOLLIN",
    "signal": "pidfd_send_signal sigtimedwait",
    "time": "CLOCK_BOOTTIME CLOCK_TAI",
}
UNIX = {
    "os": "O_CLOEXEC O_DIRECTORY O_NOCTTY O_NOFOLLOW fork forkpty getegid geteuid getgid getuid killpg mkfifo openpty "
    "pread pwrite setsid sysconf uname wait4 chown fchmod nice setpgid waitid",
    "socket": "AF_UNIX CMSG_LEN CMSG_SPACE MSG_DONTWAIT SCM_RIGHTS recv_fds send_fds SOCK_SEQPACKET",
    "mmap": "MAP_PRIVATE MAP_SHARED PROT_READ PROT_WRITE PAGESIZE",
    "select": "poll POLLIN",
    "signal": "SIGHUP SIGKILL SIGUSR1 SIGALRM pthread_sigmask sigwait setitimer",
    "time": "clock_gettime CLOCK_MONOTONIC",
}


class Refusing:
    """A finder that comes first, and refuses some modules."""

    def __init__(self, names: Sequence[str]) -> None:
        self._names = frozenset(names)

    def find_spec(self, name: str, path: object = None, target: ModuleType | None = None) -> None:
        """Raise ModuleNotFoundError for those; leave the rest to others."""
        if name in self._names:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


def _without(module: ModuleType, names: set[str]) -> ModuleType:
    """A module without some names; earlier importers keep the original."""
    less = ModuleType(module.__name__, module.__doc__)
    less.__dict__.update({name: value for name, value in module.__dict__.items() if name not in names})
    return less


def become(system: str) -> None:
    """Take away what `system` does not have."""
    import asyncio  # noqa: F401 (these are imported while this is still Linux)
    import concurrent.futures.thread  # noqa: F401
    import json  # noqa: F401
    import multiprocessing  # noqa: F401
    import shutil  # noqa: F401
    import subprocess  # noqa: F401
    import tempfile  # noqa: F401

    import numpy  # noqa: F401
    import yaml  # noqa: F401
    import zmq.asyncio
    import zmq.utils.monitor  # noqa: F401

    gone = [LINUX, UNIX] if system == "win32" else [LINUX]
    refused = [*OURS, *(UNIX_MODULES if system == "win32" else ())]
    for module in UNIX:
        hidden = {name for table in gone for name in table[module].split()}
        sys.modules[module] = _without(import_module(module), hidden)
    for name in refused:
        sys.modules.pop(name, None)
    sys.meta_path.insert(0, Refusing(refused))  # type: ignore[arg-type]
    sys.platform = system


if __name__ == "__main__":
    become(sys.argv[1])
    sys.argv = sys.argv[2:]
    runpy.run_path(sys.argv[0], run_name="__main__")
